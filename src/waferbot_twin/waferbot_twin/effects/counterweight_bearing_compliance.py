# SPDX-License-Identifier: Apache-2.0
"""The guide of the counterweight lets it tilt, (5.20) to (5.25)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, tilting_counterweight

EFFECT = compliance_effect(
    'counterweight_bearing_compliance',
    'the guide of the counterweight lets it tilt',
    tilting_counterweight,
    title='tilting compliance of the counterweight guide',
)
