# SPDX-License-Identifier: Apache-2.0
"""
Parameter constancy: a cause that is real has one size, in all parts of all logs.

What a model lacks is seldom the same twice: the next homing turns an eccentricity, the next day warms a
bearing, another motion shows other parts of a curve. A cause that stands for such a thing explains some
parts of the logs and makes others worse. So when the causes are known, each is judged once more, by a
gain that is worth no more than beside what its parts disagree by (`noise_model.heterogeneity`). One that
is not more probable than none by that is as likely as not: it stays in the model and has no name.
"""

from __future__ import annotations

from dataclasses import replace

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, Judged
from waferbot_twin.diagnosis.inference.discrepancy import is_physical
from waferbot_twin.diagnosis.inference.elimination import odds_beside
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at
from waferbot_twin.diagnosis.inference.refit import with_last
from waferbot_twin.diagnosis.inference.single_effects import Posterior, with_odds
from waferbot_twin.estimation.conditional import without_by_linear
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.hypothesis import Hypothesis


def as_sure_as_constant(pool: CandidatePool, posterior: Posterior) -> Posterior:
    """Return a posterior whose causes are no more probable than beside how their sizes vary."""
    effects = list(posterior.effects)
    places = [place for place, effect in enumerate(effects) if is_physical(effect.best.cause)]
    found, judged = posterior.found, pool.judged(posterior.found)
    parallel = Parallel(n_jobs=pool.workers, return_as='generator', batch_size=1)
    every = parallel(delayed(_log_odds)(judged, found, found.causes[n].name) for n in places)
    limit = log_odds_at(pool.settings.included_from)
    for done, (place, odds) in enumerate(zip(places, every, strict=True), 1):
        pool.progress('parameter constancy', done, len(places))
        if odds is not None:
            most = log_odds_at(effects[place].inclusion)
            effects[place] = with_odds(effects[place], min(max(odds, limit), most))
    return replace(posterior, effects=tuple(effects))


def _log_odds(judged: Judged, found: Hypothesis, name: str) -> float | None:
    """
    Return ln of the odds of a cause with the heterogeneity of its size in them, the others fitted anew.

    None if there is none in the linear problem, or the machine does not stand without the cause.
    """
    more = with_last(judged.problem, found, name)
    try:
        base = without_by_linear(judged.problem, found, name)
        if gain(more, base, parts=True) == gain(more, base):
            return None
        return odds_beside(judged, found, name, parts=True)[0]
    except UserError:
        return None
