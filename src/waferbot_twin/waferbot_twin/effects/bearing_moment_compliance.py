# SPDX-License-Identifier: Apache-2.0
"""The bearing of a rotary axis lets its shaft tilt, (5.22), (5.26)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, tilting_bearing

EFFECT = compliance_effect(
    'bearing_moment_compliance',
    'the bearing of a rotary axis gives under moments',
    tilting_bearing,
    title='tilting compliance of the bearing',
)
