# SPDX-License-Identifier: Apache-2.0
"""The bearing of a rotary axis lets its shaft move sideways, (5.22)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, shifting_bearing

EFFECT = compliance_effect(
    'bearing_radial_compliance',
    'the bearing of a rotary axis gives radially',
    shifting_bearing,
    title='radial compliance of the bearing',
)
