# SPDX-License-Identifier: Apache-2.0
"""The guide of a linear axis lets its carriage tilt, (5.20) to (5.25)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, tilting_guide

EFFECT = compliance_effect(
    'payload_bearing_compliance',
    'the guide lets its carriage tilt',
    tilting_guide,
    title='tilting compliance of the guide',
)
