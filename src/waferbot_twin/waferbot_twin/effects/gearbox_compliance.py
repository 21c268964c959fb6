# SPDX-License-Identifier: Apache-2.0
"""The gearbox of a drive twists under torque; its compliance is seen at its output."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, stage

EFFECT = compliance_effect('gearbox_compliance', 'the gearbox twists under torque', stage('gear'))
