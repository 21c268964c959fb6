# SPDX-License-Identifier: Apache-2.0
"""
Inverse dynamics by least squares: mass and friction of an axis from its position and its force.

For an axis with position q and drive force F,

    F = M q'' + b q' + c sign(q') + f_0 + ...                                            (1)

is linear in what is sought: inertia M, viscous friction b, Coulomb friction c, offset f_0 (gravity, a
zero error of the amplifier). No simulation, no start values, no model of the noise: what a competent
colleague does first, and what every other method has to beat.

**Differentiation.** q'' from encoder counts is noise, so (1) is taken through a low-pass filter L. Force
and *every* regressor pass through the same one,

    L F = M (L q)'' + b (L q)' + c L sign(q') + f_0,

which holds as exactly as (1) does whatever L is: the filter costs information, but bends nothing. L is a
Butterworth filter of 4th order, run forwards and backwards (so without phase: a delay between force and
acceleration would be taken for friction), here called by its cut-off f_c. Derivatives are central
differences of 4th order, exact to (2 pi f_c h)^4 / 90 of the acceleration at the sampling time h; f_c
is at most 1 / (10 h), where that is 0.2 %. Afterwards every n-th sample is kept, 4 f_c or more a second.

**Cut-off.** Noise in a *regressor* pulls its coefficient towards zero: M comes out too small by the
share of noise in the variance of (L q)'' beside the other regressors. The noise of the position is taken
as white, its level from the upper half of its spectrum or from its resolution (step^2 / 12), whichever
is larger; f_c is at most the frequency at which that share is `NOISE_SHARE`, half a percent. And (1) is
a rigid axis: near the first resonance it no longer is, and a position that is read late is late there
most. So halves, quarters, ... of that frequency are tried, down to the band of the motion and of the
sines that are asked for, as long as two periods are left for each coefficient, no coefficient is left
open that was not, and more of the acceleration tells the inertia than may be noise. Of those whose
inertia agrees, within 95 % intervals, with that of every lower one (Lepski's rule: bias shows as a
drift), f_c is the highest with an interval no more than a quarter wider than the narrowest.

**Dead zone.** At rest dry friction is any force up to c, so samples there say nothing and are left out:
those with a speed below four standard deviations of its noise, or below what is asked for, and those of
a position that stays within its noise for two periods of the cut-off.

**What is not told.** Filter and differences give the regressors to some 0.1 %, so a combination of
coefficients that the (scaled) regressors show a hundred times less than another one, a condition index
above 100, is told by those errors alone. It is left open: sign(q') and the constant of f_0 after a
motion in one direction differ only by how the filter settles where it began.

**Intervals.** What (1) lacks comes back with every motion, so residuals e are far from independent, and
the usual formula gives intervals many times too narrow. The covariance is the sandwich

    (X'X)^-1 S (X'X)^-1,    S = N times the spectrum of the scores x_t e_t at frequency zero,

S from the first B cosine transforms of the scores, and 95 % intervals from Student's t with B degrees of
freedom. B = 0.4 n^(2/3) with n the *effective* number of samples, N (1 - r) / (1 + r) with r the
correlation of neighbouring scores. They heed correlation, not bias: where (1) is wrong, they are
intervals of the best wrong model.

Sources: M. Gautier, A. Janot, P.-O. Vandanjon, A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Trans. Control Syst. Technol. 21 (2013), the reference method of
section II; O. V. Lepski, Theory Probab. Appl. 35 (1990); W. A. Fuller, Measurement Error Models, 1987,
section 1.1 (attenuation); D. A. Belsley, E. Kuh, R. E. Welsch, Regression Diagnostics, 1980, section 3.2
(condition indices); E. Lazarus, D. J. Lewis, J. H. Stock, M. W. Watson, HAR inference:
recommendations for practice, J. Bus. Econ. Stat. 36 (2018) (cosine transforms, their number); D. W. K.
Andrews, Econometrica 59 (1991) (sandwich).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import binary_dilation, binary_opening, maximum_filter1d, minimum_filter1d
from scipy.signal import butter, sosfiltfilt
from scipy.stats import t as student

from waferbot_lockstep.errors import UserError

Array = NDArray[np.float64]

ORDER = 4
"""Order of the Butterworth filter, for each of its two ways."""

NOISE_SHARE = 0.005
"""Share of noise in the variance of the acceleration, and so of the inertia that is lost."""

HIGHEST_SHARE = 0.1
"""Highest cut-off as a share of the sampling rate: what the differences allow."""

HIGHEST_OF_ALL = 0.45
"""Highest cut-off that can be asked for, as a share of the sampling rate."""

KEPT_PER_CUT_OFF = 4.0
"""Samples kept, as a multiple of the cut-off."""

SETTLING = 1.0
"""Ends of a stretch that are left out, in periods of the cut-off: the filter settles there."""

LEAST_SAMPLES = 64
"""Samples of a stretch at least."""

AT_REST = 4.0
"""Standard deviations of the speed's noise below which an axis may be at rest."""

FEWEST_TRANSFORMS = 4
"""Cosine transforms at least."""

COLLINEAR = 0.01
"""Singular value, over the largest, below which a combination of coefficients is not determined."""

INVOLVED = 0.1
"""Part of a coefficient in such a combination, from which on it is not determined either."""

FEWEST_PERIODS, FOR_EACH, OF_MOTION = 5.0, 2.0, 0.99
"""
Of the lowest cut-off: its periods in the longest stretch, at least, and for each coefficient; share of
the speed's variance below it.
"""

AS_NARROW = 1.25
"""Interval of the inertia over the narrowest of all cut-offs, up to which a higher cut-off is taken."""

RISE_SPEEDS = 40
"""Speeds that are tried for a friction which rises from rest."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """
    An axis over a time without a gap: `position` (m, rad) and `force` (N, Nm, or A), every `step_s`.

    `resolution` is the step of the position, 0 if it is not known.
    """

    step_s: float
    position: Array
    force: Array
    resolution: float = 0.0


@dataclass(frozen=True)
class Terms:
    """
    What stands on the right of (1) beside inertia, Coulomb friction and offset, which always do.

    `by_direction`: viscous friction forwards and backwards apart. (Coulomb friction by direction is
    Coulomb friction and offset.) `rise_speed`, m/s or rad/s: c becomes c + a exp(-|q'| / rise_speed),
    a > 0 for Stribeck's friction, a < 0 for one that rises from rest; NaN to find that speed.
    `wave_numbers`, rad per m or rad: a sine and a cosine of the position each; 1 on an axis that turns
    is gravity.
    """

    by_direction: bool = False
    rise_speed: float | None = None
    wave_numbers: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Filtered:
    """
    A stretch behind the filter, every n-th sample: (N,) each.

    `columns` are the regressors by name, `speed` and `position` are those of the filter too. `moving`
    tells where the axis is not at rest and the filter has settled.
    """

    columns: Mapping[str, Array]
    force: Array
    speed: Array
    position: Array
    moving: NDArray[np.bool_]
    step_s: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    Coefficients by least squares: `value`, `standard_error`, `low95`, `high95` (k,) by `names`.

    A coefficient that is not `determined` (its column is a combination of others) has no interval:
    NaN. `degrees` is that of Student's t. `told` (k,) is the share of each regressor's square that the
    others do not explain, one over its variance inflation factor: a slow swing under gravity
    accelerates nearly as the sine of its angle, and tells next to nothing of the inertia.
    """

    names: tuple[str, ...]
    value: Array
    standard_error: Array
    low95: Array
    high95: Array
    determined: NDArray[np.bool_]
    degrees: int
    told: Array

    def of(self, columns: Mapping[str, Array]) -> Array:
        """Return the force (N,) that the coefficients make of these regressors."""
        return np.column_stack([columns[name] for name in self.names]) @ self.value


def position_noise(stretch: Stretch) -> float:
    """
    Return the standard deviation of the position's white noise, m or rad.

    From the median of the upper half of the spectrum of its second differences, over what these make
    of white noise; at least that of rounding to the resolution.
    """
    difference = np.diff(stretch.position, 2)
    window = np.hanning(len(difference) + 2)[1:-1]
    power = np.abs(np.fft.rfft(window * difference)) ** 2 / np.sum(window**2)
    angle = 2.0 * np.pi * np.fft.rfftfreq(len(difference))
    upper = angle > 0.5 * np.pi
    # The median of an exponentially distributed power is ln 2 of its mean.
    white = np.median(power[upper] / (2.0 - 2.0 * np.cos(angle[upper])) ** 2) / math.log(2.0)
    return math.sqrt(max(float(white), stretch.resolution**2 / 12.0))


def cut_off(stretches: Sequence[Stretch]) -> float:
    """
    Return the cut-off frequency in Hz: the highest at which noise is `NOISE_SHARE` of the acceleration.

    At most `HIGHEST_SHARE` of the slowest sampling rate, and at least `FEWEST_PERIODS` in the longest
    stretch: where even there the acceleration is noise, the inertia is attenuated (`noise_share`).
    """
    highest = min(HIGHEST_SHARE / one.step_s for one in stretches)
    lowest = min(fewest_periods(stretches), highest)
    tried = np.geomspace(lowest, highest, 60)
    clean = [noise_share(stretches, hz) <= NOISE_SHARE for hz in tried]
    return float(tried[max(np.flatnonzero(clean), default=0)])


def motion_band(stretches: Sequence[Stretch], highest_hz: float) -> float:
    """
    Return the frequency below which a filter would take the motion itself away, Hz.

    Below it is `OF_MOTION` of the variance of the speed up to `highest_hz`, in the longest stretch.
    """
    longest = max(stretches, key=lambda one: len(one.position) * one.step_s)
    speed = np.diff(longest.position)
    power = np.abs(np.fft.rfft(np.hanning(len(speed)) * (speed - speed.mean()))) ** 2
    frequency_hz = np.fft.rfftfreq(len(speed), longest.step_s)
    below = np.cumsum(power[frequency_hz <= highest_hz])
    return float(frequency_hz[np.searchsorted(below, OF_MOTION * below[-1])])


def band_of_sines(stretches: Sequence[Stretch], highest_hz: float, terms: Terms) -> float:
    """Return the frequency with which the shortest of the sines passes at the median speed, Hz."""
    ways_per_s = []
    for one in stretches:
        lag = min(math.ceil(1.0 / (highest_hz * one.step_s)), len(one.position) - 1)
        way = np.abs(one.position[lag:] - one.position[:-lag])
        ways_per_s.append(way / (lag * one.step_s))
    speed = float(np.median(np.concatenate(ways_per_s)))
    return max(terms.wave_numbers, default=0.0) / (2.0 * math.pi) * speed


def fewest_periods(stretches: Sequence[Stretch], periods: float = FEWEST_PERIODS) -> float:
    """Return the frequency that has so many periods in the longest stretch, Hz."""
    return periods / max(len(one.position) * one.step_s for one in stretches)


def noise_share(stretches: Sequence[Stretch], cut_off_hz: float) -> float:
    """
    Return the share of noise in the variance of the acceleration below a frequency, 0 to 1.

    Of a position whose noise has the variance s^2 per sample, the acceleration has, below f, the
    variance s^2 2 h (2 pi)^4 f^5 / 5 at the sampling time h.
    """
    noise = all_of = 0.0
    for one in stretches:
        count = len(one.position) - 2
        window = np.hanning(count + 2)[1:-1]
        curvature = np.diff(one.position, 2) / one.step_s**2
        power = np.abs(np.fft.rfft(window * curvature)) ** 2 / (np.sum(window**2) * count)
        below = np.fft.rfftfreq(count, one.step_s) <= cut_off_hz
        all_of += count * 2.0 * float(np.sum(power[below]))
        per_hz = 2.0 * one.step_s * position_noise(one) ** 2
        noise += count * per_hz * (2.0 * math.pi) ** 4 * cut_off_hz**5 / 5.0
    return min(noise / all_of, 1.0) if all_of > 0.0 else 1.0


def attenuation(stretches: Sequence[Stretch], cut_off_hz: float, found: Estimate) -> float:
    """Return the share of noise in what tells the inertia of a fit below a frequency, 0 to 1."""
    told = float(found.told[found.names.index('inertia')])
    return min(noise_share(stretches, cut_off_hz) / told, 1.0) if told > 0.0 else 1.0


def derivatives(position: Array, step_s: float) -> tuple[Array, Array]:
    """
    Return first and second derivative, (N,) each, by central differences of 4th order.

    The two samples at each end are those beside them.
    """
    q = position
    first, second = np.empty_like(q), np.empty_like(q)
    first[2:-2] = (8.0 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12.0 * step_s)
    second[2:-2] = (16.0 * (q[3:-1] + q[1:-3]) - (q[4:] + q[:-4]) - 30.0 * q[2:-2]) / (
        12.0 * step_s**2
    )
    for one in (first, second):
        one[:2], one[-2:] = one[2], one[-3]
    return first, second


def low_pass_of(stretch: Stretch, cut_off_hz: float) -> tuple[Callable[[Array], Array], int]:
    """
    Return the low-pass filter of a stretch, and at each end how many samples it settles for.

    Raises `UserError` for a stretch that is too short, or a cut-off that is too high for it.
    """
    rate_hz = 1.0 / stretch.step_s
    if cut_off_hz >= HIGHEST_OF_ALL * rate_hz:
        raise UserError(
            f'a cut-off (--cut-off) of {cut_off_hz:g} Hz is too high for {rate_hz:.4g} samples '
            f'a second; it must be below {HIGHEST_OF_ALL * rate_hz:.4g} Hz, not quite half'
        )
    settling = math.ceil(SETTLING * rate_hz / cut_off_hz)
    if len(stretch.position) < max(LEAST_SAMPLES, 3 * settling):
        raise UserError(
            f'{len(stretch.position)} samples without a gap are too few for a filter of '
            f'{cut_off_hz:.3g} Hz; it needs {max(LEAST_SAMPLES, 3 * settling)}'
        )
    sections = butter(ORDER, cut_off_hz, fs=rate_hz, output='sos')
    reach = min(len(stretch.position) - 1, 3 * settling)

    def low_pass(value: Array) -> Array:
        return np.asarray(sosfiltfilt(sections, value, padlen=reach))

    return low_pass, settling


def filtered(
    stretch: Stretch, cut_off_hz: float, terms: Terms, dead_zone: float = 0.0
) -> Filtered:
    """
    Return force and regressors of a stretch behind the filter.

    `dead_zone` in m/s or rad/s. Raises `UserError` for a stretch that is too short.
    """
    low_pass, settling = low_pass_of(stretch, cut_off_hz)
    step_s, rate_hz = stretch.step_s, 1.0 / stretch.step_s
    position = low_pass(stretch.position)
    speed, acceleration = derivatives(position, step_s)
    noise = position_noise(stretch)
    # White noise below f_c, differentiated: its variance is s^2 2 h (2 pi)^2 f_c^3 / 3.
    speed_noise = noise * 2.0 * math.pi * math.sqrt(2.0 * step_s * cut_off_hz**3 / 3.0)
    rest = np.abs(speed) <= max(dead_zone, AT_REST * speed_noise)
    sign = np.where(rest, 0.0, np.sign(speed))
    columns = {'inertia': acceleration}
    if terms.by_direction:
        columns['viscous_forward'] = low_pass(np.maximum(speed, 0.0))
        columns['viscous_backward'] = low_pass(np.minimum(speed, 0.0))
    else:
        columns['viscous'] = speed
    columns['coulomb'] = low_pass(sign)
    columns['offset'] = np.ones(len(speed))
    if terms.rise_speed is not None:
        columns['rise'] = low_pass(sign * np.exp(-np.abs(speed) / terms.rise_speed))
    for place, number in enumerate(terms.wave_numbers, start=1):
        columns[f'cosine_{place}'] = low_pass(np.cos(number * stretch.position))
        columns[f'sine_{place}'] = low_pass(np.sin(number * stretch.position))
    # Beside a long rest the filter carries over what holds the axis there; a reversal is no rest.
    resting = binary_opening(rest, np.ones(settling)) | standing(stretch, 2 * settling + 1)
    moving = ~rest & ~binary_dilation(resting, np.ones(2 * settling + 1))
    moving[:settling] = moving[-settling:] = False
    keep = slice(None, None, max(1, int(rate_hz / (KEPT_PER_CUT_OFF * cut_off_hz))))
    return Filtered(
        {name: column[keep] for name, column in columns.items()},
        low_pass(stretch.force)[keep],
        speed[keep],
        position[keep],
        moving[keep],
        step_s * (keep.step or 1),
    )


def standing(stretch: Stretch, samples: int) -> NDArray[np.bool_]:
    """
    Return where the position (N,) stays within its noise for so many samples on end, an odd number.

    The filtered speed does not show it: before a start and behind a stop the filter swings both ways.
    """
    q = stretch.position
    path = maximum_filter1d(q, samples, mode='nearest') - minimum_filter1d(
        q, samples, mode='nearest'
    )
    stays = path <= 2.0 * AT_REST * position_noise(stretch)
    return np.asarray(binary_dilation(stays, np.ones(samples)))


def joined(parts: Sequence[Filtered]) -> tuple[dict[str, Array], Array]:
    """Return regressors and force of all samples of these stretches that move, one after another."""
    return (
        {
            name: np.concatenate([part.columns[name][part.moving] for part in parts])
            for name in parts[0].columns
        },
        np.concatenate([part.force[part.moving] for part in parts]),
    )


def least_squares(
    columns: Mapping[str, Array], force: Array, weight: Array | None = None
) -> Estimate:
    """
    Return the coefficients (k,) of regressors (N,) each, by (weighted) least squares.

    `weight` (N,) is one over the variance of each sample, up to a factor; one for all by default.
    Samples follow one another in time: intervals heed how residuals correlate. Raises `UserError` for
    fewer samples than coefficients.
    """
    names = tuple(columns)
    matrix = np.column_stack([columns[name] for name in names])
    if len(force) <= 2 * len(names):
        raise UserError(
            f'{len(force)} samples in motion are too few for {len(names)} coefficients '
            f'({", ".join(names)})'
        )
    root = np.ones(len(force)) if weight is None else np.sqrt(weight)
    matrix, right = matrix * root[:, None], force * root
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    left, singular, turned = np.linalg.svd(matrix / scale, full_matrices=False)
    usable = singular > COLLINEAR * singular[0]
    inverse = np.where(usable, 1.0 / np.where(usable, singular, 1.0), 0.0)
    value = (turned.T * inverse) @ (left.T @ right) / scale
    undetermined = np.abs(turned[~usable]).max(axis=0, initial=0.0) > INVOLVED
    scores = (right - matrix @ value)[:, None] * left
    spectrum, degrees = spectrum_at_zero(scores)
    half = turned.T * inverse
    covariance = half @ spectrum @ half.T * len(force) / np.outer(scale, scale)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    error = np.where(undetermined, np.nan, error)
    reach = float(student.ppf(0.975, degrees)) * error
    told = np.where(undetermined, 0.0, 1.0 / np.sum(half**2, axis=1))
    return Estimate(
        names, value, error, value - reach, value + reach, ~undetermined, degrees, told
    )


def spectrum_at_zero(scores: Array) -> tuple[Array, int]:
    """
    Return the long-run covariance (k, k) of scores (N, k), and its degrees of freedom.

    That is the sum of their autocovariances over all lags, from the lowest cosine transforms.
    """
    count = len(scores)
    from_mean = scores - scores.mean(axis=0)
    square = np.sum(from_mean**2, axis=0)
    alike = np.sum(from_mean[1:] * from_mean[:-1], axis=0)
    usable = square > 0.0
    correlation = float(
        np.clip(np.max(alike[usable] / square[usable], initial=0.0), 0.0, 0.999999)
    )
    effective = count * (1.0 - correlation) / (1.0 + correlation)
    transforms = min(max(FEWEST_TRANSFORMS, round(0.4 * effective ** (2.0 / 3.0))), count - 1)
    low = dct(from_mean, type=2, axis=0)[1 : transforms + 1] / math.sqrt(2.0 * count)
    return np.asarray(low.T @ low) / transforms, transforms


def relative_error(force: Array, residual: Array) -> float:
    """Return the root of sum e^2 / sum F^2: 0 for a perfect model, 1 for none."""
    square = float(force @ force)
    return math.sqrt(float(residual @ residual) / square) if square > 0.0 else math.nan


def estimate(
    stretches: Sequence[Stretch],
    terms: Terms | None = None,
    cut_off_hz: float | None = None,
    dead_zone: float = 0.0,
) -> tuple[Estimate, Terms, float]:
    """
    Return the coefficients of (1), the terms with whatever was sought in them, and the cut-off, Hz.

    The speed of a friction that rises from rest is that of the smallest residual, from twice the dead
    zone (at least a hundredth of the highest speed) to half of the highest speed; intervals take it
    as known. Stretches that are too short are left out; raises `UserError` if all are, or nothing moves.
    """
    terms = terms or Terms()
    if cut_off_hz is not None:
        return *_estimate_at(stretches, terms, cut_off_hz, dead_zone), cut_off_hz
    tried = [cut_off(stretches)]
    fits = [_estimate_at(stretches, terms, tried[0], dead_zone)]
    lowest = max(
        motion_band(stretches, tried[0]),
        fewest_periods(stretches, FOR_EACH * len(fits[0][0].names)),
        band_of_sines(stretches, tried[0], terms),
    )
    while 0.5 * tried[-1] >= lowest:
        lower_hz = 0.5 * tried[-1]
        try:
            lower = _estimate_at(stretches, terms, lower_hz, dead_zone)
        except UserError:
            break  # nothing moves for long enough
        if np.any(fits[-1][0].determined & ~lower[0].determined):
            break
        if len(tried) == 1 and attenuation(stretches, tried[0], fits[0][0]) > NOISE_SHARE:
            tried, fits = [], []
        elif lower[0].told[lower[0].names.index('inertia')] < NOISE_SHARE:
            break
        tried.append(lower_hz)
        fits.append(lower)
    place = _chosen([found for found, _ in fits])
    return *fits[place], tried[place]


def _chosen(fits: Sequence[Estimate]) -> int:
    """Return the place of the cut-off to take, from fits at falling ones; see the module."""
    inertia = [one.names.index('inertia') for one in fits]
    value = np.array([one.value[place] for one, place in zip(fits, inertia, strict=True)])
    reach = np.array([one.high95[place] for one, place in zip(fits, inertia, strict=True)]) - value
    if not np.isfinite(reach).all():
        return 0  # the inertia is not determined: nothing to compare
    agrees = [
        place
        for place in range(len(fits))
        if (
            np.abs(value[place + 1 :] - value[place]) <= np.hypot(reach[place + 1 :], reach[place])
        ).all()
    ]
    narrowest = min(reach[place] for place in agrees)
    return next(place for place in agrees if reach[place] <= AS_NARROW * narrowest)


def _estimate_at(
    stretches: Sequence[Stretch], terms: Terms, cut_off_hz: float, dead_zone: float
) -> tuple[Estimate, Terms]:
    """Return the coefficients at one cut-off, and the terms with the speed that was sought in them."""

    def solved(speed: float | None) -> tuple[float, Estimate]:
        parts = filter_all(stretches, cut_off_hz, replace(terms, rise_speed=speed), dead_zone)
        columns, force = joined(parts)
        found = least_squares(columns, force)
        return float(np.sum((force - found.of(columns)) ** 2)), found

    speed = terms.rise_speed
    if speed is not None and math.isnan(speed):
        parts = filter_all(stretches, cut_off_hz, Terms(), dead_zone)
        highest = max(float(np.abs(part.speed).max()) for part in parts)
        lowest = max(2.0 * dead_zone, 0.01 * highest)
        speed = _least(lambda tried: solved(tried)[0], lowest, 0.5 * highest)
    return solved(speed)[1], replace(terms, rise_speed=speed)


def filter_all(
    stretches: Sequence[Stretch], cut_off_hz: float, terms: Terms, dead_zone: float
) -> list[Filtered]:
    """Return stretches behind the filter but for those that are too short; `UserError` if all are."""
    parts, complaint = [], None
    for one in stretches:
        try:
            parts.append(filtered(one, cut_off_hz, terms, dead_zone))
        except UserError as error:
            complaint = error
    if not parts:
        raise complaint or UserError('there is nothing to fit')
    if not any(part.moving.any() for part in parts):
        raise UserError('the axis never moves beyond the noise of its position')
    return parts


def _least(cost: Callable[[float], float], low: float, high: float) -> float:
    """Return where on a logarithmic grid a cost is smallest."""
    tried = np.geomspace(low, max(high, low * 1.01), RISE_SPEEDS)
    return float(min(tried, key=lambda value: cost(float(value))))
