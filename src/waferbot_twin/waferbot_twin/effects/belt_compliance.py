# SPDX-License-Identifier: Apache-2.0
"""The belt of a drive stretches, (5.32) to (5.36)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, stage

EFFECT = compliance_effect('belt_compliance', 'the belt of the drive stretches', stage('belt'))
