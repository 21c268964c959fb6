# SPDX-License-Identifier: Apache-2.0
"""
The map of a gearbox's loss over speed and load, fitted to the points of its test.

The map is bilinear between nodes, speeds s_i and loads L_j, and constant beyond them, as
`waferbot_plant.friction_laws` takes it. With the hat functions h of the nodes (one at its own node, zero
at the others, straight between) a point at speed n_k and input torque F_k reads

    T_k = sum over i, j of h_i(|n_k|) h_j(|F_k|) T_ij + noise of standard error e_k,

linear in the T_ij, which are found by least squares with weights 1 / e_k^2 and T_ij >= 0. Their
covariance is (A' W A)^-1, times the residuals' variance in units of e_k^2 where that is above one: what
the map cannot follow counts as noise. Where a point has no standard error all weigh the same and the
variance is that of the residuals.

Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, SIAM 1995, chapter 23. Limits: errors
hold for nodes that are not at zero, and are about a tenth too small where the e_k are from ten blocks
each, as then the weights are chance too; F_k is taken as exact, though the loss is measured with it,
which is right as long as the loss changes little with it (dT/dF well below one).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from waferbot_lockstep.errors import UserError
from waferbot_plant.elements import LONGEST_TABLE, MOST_LOADS
from waferbot_twin.library.gearbox_points import Points

Array = NDArray[np.float64]

GAP = 0.05
"""Values further apart than this share of the largest are at different nodes."""

_SUPPORT = 1e-3
"""Least singular value over the largest, of a combination of nodes that the points tell."""
_SHARE = 0.1
"""Share in what the points do not tell from which a node is one of those not supported."""


@dataclass(frozen=True)
class LossMap:
    """
    Losses (loads, speeds) at `speeds` in rad/s and `loads`, and their standard errors, in Nm.

    Errors are NaN if points without errors of their own are no more than nodes. `residuals` (points,)
    in Nm; `scatter` is their root mean square in units of the points' standard errors, by degrees of
    freedom, NaN where there are none.
    """

    speeds: Array
    loads: Array
    losses: Array
    errors: Array
    residuals: Array
    scatter: float

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, Nm."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def at(self, speed: Array, load: Array) -> Array:
        """Return the loss (n,) in Nm at speeds (n,) and loads (n,), magnitudes."""
        return hats(speed, load, self.speeds, self.loads) @ self.losses.ravel()


def nodes_of(values: Array, most: int, name: str) -> Array:
    """
    Return nodes for magnitudes (n,): the means of groups that lie together, and both ends.

    Raises `UserError` if there would be more than `most`.
    """
    rising = np.sort(values)
    groups = np.split(rising, np.flatnonzero(np.diff(rising) > GAP * rising[-1]) + 1)
    if len(groups) > most:
        raise UserError(
            f'the test has {len(groups)} {name}, a map {most} at most: say which, by --{name}'
        )
    nodes = np.array([group.mean() for group in groups])
    if len(nodes) > 1:
        nodes[0], nodes[-1] = rising[0], rising[-1]
    return nodes


def hats(speed: Array, load: Array, speeds: Array, loads: Array) -> Array:
    """Return the weights (n, loads x speeds) of the nodes at n speeds and loads; rows add to one."""
    over_speed, over_load = (
        np.column_stack([np.interp(values, nodes, one) for one in np.eye(len(nodes))])
        for values, nodes in ((speed, speeds), (load, loads))
    )
    weights = np.einsum('kj,ki->kji', over_load, over_speed)
    return weights.reshape(len(speed), len(loads) * len(speeds))


def fit(
    points: Points, speeds: Sequence[float] | None = None, loads: Sequence[float] | None = None
) -> LossMap:
    """
    Return the map at speeds (rad/s) and loads (Nm), by default where the points are.

    Raises `UserError` for nodes that do not rise from zero or more, and, naming them, for nodes that
    no points support.
    """
    # A description's map begins at zero, which may take a node more of each.
    speed_nodes, load_nodes = (
        nodes_of(values, most - 1, name) if given is None else _checked(given, most, name)
        for values, most, name, given in (
            (np.abs(points.speed), LONGEST_TABLE, 'speeds', speeds),
            (points.load, MOST_LOADS, 'loads', loads),
        )
    )
    columns = hats(np.abs(points.speed), points.load, speed_nodes, load_nodes)
    _check_support(columns, speed_nodes, load_nodes)
    known = bool(np.all(np.isfinite(points.error) & (points.error > 0.0)))
    weight = 1.0 / points.error if known else np.ones(len(points.loss))
    weighted = columns * weight[:, None]
    losses, _ = nnls(weighted, points.loss * weight)
    residuals = points.loss - columns @ losses
    freedom = len(residuals) - len(losses)
    variance = float(np.sum((residuals * weight) ** 2)) / freedom if freedom > 0 else np.nan
    inflation = np.fmax(1.0, variance) if known else variance
    errors = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)) * inflation)
    shape = len(load_nodes), len(speed_nodes)
    return LossMap(
        speed_nodes,
        load_nodes,
        losses.reshape(shape),
        errors.reshape(shape),
        residuals,
        float(np.sqrt(variance)) if known else float('nan'),
    )


def from_zero(found: LossMap) -> LossMap:
    """Return the map as a description takes it, from speed and load zero: constant below its first."""
    losses, errors = found.losses, found.errors
    speeds, loads = found.speeds, found.loads
    if speeds[0] > 0.0:
        speeds = np.concatenate([[0.0], speeds])
        losses, errors = (np.column_stack([one[:, :1], one]) for one in (losses, errors))
    if loads[0] > 0.0:
        loads = np.concatenate([[0.0], loads])
        losses, errors = (np.vstack([one[:1], one]) for one in (losses, errors))
    return LossMap(speeds, loads, losses, errors, found.residuals, found.scatter)


def by_quarter(points: Points, found: LossMap) -> dict[str, tuple[int, float]]:
    """
    Return number of points and mean residual (Nm, NaN of none) of each direction and flank of power.

    The map is the same for all four; what differs between them shows here.
    """
    quarters = {}
    for direction, forward in (('forward', True), ('backward', False)):
        for flank, driving in (('driving', True), ('driven', False)):
            own = ((points.speed > 0.0) == forward) & (points.driving == driving)
            mean = float(found.residuals[own].mean()) if own.any() else float('nan')
            quarters[f'{direction}, {flank}'] = int(own.sum()), mean
    return quarters


def empty_cells(points: Points, found: LossMap) -> list[tuple[float, float, float, float]]:
    """Return the cells of the grid without a point: speeds from, to (rad/s), loads from, to (Nm)."""
    speed, load = np.abs(points.speed), points.load
    return [
        (float(slow), float(fast), float(low), float(high))
        for low, high in zip(found.loads[:-1], found.loads[1:], strict=True)
        for slow, fast in zip(found.speeds[:-1], found.speeds[1:], strict=True)
        if not ((speed >= slow) & (speed <= fast) & (load >= low) & (load <= high)).any()
    ]


def _checked(given: Sequence[float], most: int, name: str) -> Array:
    """Return nodes that a user gave, if a description can have them."""
    nodes = np.array(given, float)
    fits = len(nodes) + (nodes[0] > 0.0) <= most
    if not (
        np.isfinite(nodes).all() and nodes[0] >= 0.0 and (np.diff(nodes) > 0.0).all() and fits
    ):
        raise UserError(
            f'--{name} must rise, from zero or more, at most {most} with zero; they are '
            f'{", ".join(f"{node:g}" for node in nodes)}'
        )
    return nodes


def _check_support(columns: Array, speeds: Array, loads: Array) -> None:
    """Refuse nodes that stand in a combination which no point tells."""
    _, singular, directions = np.linalg.svd(columns, full_matrices=True)
    told = int(np.sum(singular > _SUPPORT * singular[0]))
    lost = np.linalg.norm(directions[told:], axis=0) > _SHARE
    if lost.any():
        named = ', '.join(
            f'{speeds[node % len(speeds)]:.4g} rad/s with {loads[node // len(speeds)]:.4g} Nm'
            for node in np.flatnonzero(lost)
        )
        raise UserError(
            f'no points of the test support the map at {named}; measure there, or give other '
            '--speeds and --loads'
        )
