# SPDX-License-Identifier: Apache-2.0
"""
What has no name, and what it would gain in the validation data beside the extended model.

The extended model holds named causes alone. Possible ones may be true as well. And where a force over
speed or position is left that no cause explains (`inference.discrepancy`), a model that has it as a
table is as near to the machine as a force of that kind can bring it: what is still missing after that is
something else. All are fitted to the estimation data alone, as for every gain (`validation.holdout`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy
from waferbot_twin.diagnosis.inference.nuisance import is_nuisance
from waferbot_twin.residuals.problem import Problem, apply_all
from waferbot_twin.validation.gain import AxisGain, gains
from waferbot_twin.validation.holdout import fitted_to

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import Diagnosis


def gains_with_unnamed(diagnosis: Diagnosis) -> list[AxisGain]:
    """
    Return the gain of every axis in every validation log with all that has no name.

    None where there is nothing of the kind, or where the machine does not run with it.
    """
    causes = (*diagnosis.after.causes, *(found.cause for found in diagnosis.possible))
    if not diagnosis.possible and not any(is_discrepancy(cause) for cause in causes):
        return []
    nominal, records = diagnosis.nominal, diagnosis.problem.records
    usual = [
        [item.name for item in cause.effect.parameters(nominal, cause.axis)]
        for cause in causes
        if is_nuisance(cause)
    ]
    count = len(diagnosis.estimation)
    estimation = Problem(nominal, records[:count])
    settings = diagnosis.settings
    scales = settings.prior_scales, settings.unrated_scales
    try:
        fitted = fitted_to(estimation.with_prior(usual, *scales), causes)
        return gains(nominal, apply_all(nominal, fitted.causes), records[count:])
    except UserError:
        return []
