# SPDX-License-Identifier: Apache-2.0
"""
The search for effects: one after the other, then all again.

Effects are added as long as one is more probable than not (`forward_selection`). Where much lacks, all
that is held rigid may give as well (`flexible_model`) and what an axis carries be another load
(`load_model`). What is not evident goes (`elimination`). Then each is asked for anew beside all others,
as often as one changes (`revision`). Where one of those that were asked for has gone, what it stood for
may still lack: more are added, beside causes beside which was not asked yet, and so on (stepwise
selection). The posterior of each is that of
`single_effects`, from fits through the simulation for every candidate that the linear problem puts
within reach (`refit`). Models that other choices lead to are weighed against the one that was found
(`rival_models`). Last, what the closed loop has made of noise is taken out (`feigned`).
"""

from __future__ import annotations

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.elimination import evident
from waferbot_twin.diagnosis.inference.feigned import without_feigned
from waferbot_twin.diagnosis.inference.flexible_model import or_flexible
from waferbot_twin.diagnosis.inference.forward_selection import Found, as_fitted, ask_on
from waferbot_twin.diagnosis.inference.load_model import or_other_loads
from waferbot_twin.diagnosis.inference.model_average import open_models
from waferbot_twin.diagnosis.inference.refit import fitted, to_the_end
from waferbot_twin.diagnosis.inference.revision import ask_again
from waferbot_twin.diagnosis.inference.rival_models import beside_rival_models
from waferbot_twin.diagnosis.inference.single_effects import Posterior, SingleEffect, with_odds
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate


def infer(pool: CandidatePool, begun: Posterior | None = None) -> Posterior:
    """
    Return the posterior over causes of the logs of a pool.

    From what was found in them with another observer, if it has `begun` so. Raises `UserError` if the
    nominal model does not run in their motions.
    """
    nothing = evaluate(pool.problem)
    found, effects = nothing, list[SingleEffect]()
    if begun is not None:
        causes = begun.found.causes
        found = fitted(pool.problem, causes, pool.workers, near=begun.found) or nothing
        effects = [
            with_odds(as_fitted(pool, found, cause), effect.log_odds)
            for cause, effect in zip(found.causes, begun.effects, strict=False)
        ]
    pool.begin(found)
    pool.note_noise_of(found)
    most = pool.settings.most_asked
    pool.asked_beside.clear()
    pool.rivals.clear()
    usual = begun is not None
    while True:
        found, effects, tentative, wanted, asked = ask_on(
            pool, found, effects, most, usual, beside_whole_models
        )
        most -= asked
        found, effects = evident(pool, found, effects, tentative)
        found, effects, asked = ask_again(pool, found, effects, most)
        most -= asked
        names = frozenset(cause.name for cause in found.causes)
        if most > 0 and not names.issuperset(wanted) and names not in pool.asked_beside:
            usual = True
            continue
        found, effects, asked = beside_rival_models(pool, found, effects, most)
        most -= asked
        found, effects, feigned = without_feigned(pool, found, effects)
        if not feigned:
            found = to_the_end(pool.problem, found, pool.workers)
            models = open_models(pool, found, effects)
            return Posterior(nothing, found, tuple(effects), len(pool.names), models)
        for name in feigned:
            pool.leave_out(name)


def beside_whole_models(
    pool: CandidatePool,
    found: Hypothesis,
    effects: list[SingleEffect],
    tentative: list[SingleEffect],
) -> Found:
    """Return the most probable of the model that was found, the flexible one, that with other loads."""
    found, effects, tentative = or_flexible(pool, found, effects, tentative)
    return or_other_loads(pool, found, effects, tentative)
