# SPDX-License-Identifier: Apache-2.0
"""The shaft of a rotary axis bends, (5.30), (5.31)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import bending_shaft, compliance_effect

EFFECT = compliance_effect(
    'shaft_bending_compliance',
    'the shaft of a rotary axis bends',
    bending_shaft,
    title='bending compliance of the shaft',
)
