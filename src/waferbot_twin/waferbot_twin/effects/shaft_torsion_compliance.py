# SPDX-License-Identifier: Apache-2.0
"""The shaft of a rotary axis twists, (5.27) to (5.29)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, twisting_shaft

EFFECT = compliance_effect(
    'shaft_torsion_compliance',
    'the shaft of a rotary axis twists',
    twisting_shaft,
    title='torsional compliance of the shaft',
)
