# SPDX-License-Identifier: Apache-2.0
"""
Encoders: position to whole counts, rounded down, some phase cycles late.

The thesis (chapter 4) multiplies the position by the counts per unit, rounds down, and passes the
count through a unit delay at the phase rate, because feedback over the MACRO ring is always that
of the previous cycle. So at an encoder tick (every `encoder_divider` ticks) the published counts
are those read `encoder_delay` encoder ticks before.

Imperfections
-------------
All are off unless the description names them. With x the position in counts at an encoder tick and
x_before that at the one before, the reading is made in this order:

    u = x + f (x_before - x)                              delay_fraction f, phase cycles; delay_s
    v = (1 + e) u + A cos(2 pi u / P - phi)               scale_error e, eccentricity A, P, phi
    w = v + B cos(2 pi v / Q - psi)                       interpolation B, Q, psi
    count = floor(C floor((w - lost + noise) / C))        coarseness_counts C

- `scale_error`: relative, -. `eccentricity`: amplitude and period in m or rad of the coordinate; one
  period per turn of a disc that sits off its axis; the error has its peak at phi = 2 pi u / P.
- `interpolation`: cyclic error of the interpolator, in counts over one signal period of Q counts.
- `delay_fraction`: a straight line between two readings, so exact for constant speed; motion of
  frequency F is also weakened, most by half a cycle: by cos(pi F / phase rate), 0.5 % at 300 Hz and
  9 kHz. `extra_delay_cycles`: whole cycles more. `delay_s`: a time more, whatever the cycle: whole
  cycles of it, and a fraction for the rest.
- `noise_counts`: rms of white noise, a new value at each encoder tick.
- `lost_counts`: whenever the position passes a mark, in either direction, so many counts are lost
  for good. The marks lie at 1/2, 3/2, ... of the spacing on both sides of zero, so that home is not
  at one; several passed between two readings all count.
- `coarseness_counts`: only multiples of it are seen.

Each is continuous in its parameter (of a whole number of cycles and of the coarseness, as far as
counts can be) and neutral at zero; the coarseness at one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.noise import normal
from waferbot_lockstep.timing import Timing
from waferbot_plant.description import LONGEST_DELAY, LONGEST_DELAY_S, Encoder
from waferbot_plant.multibody import sine_and_cosine

READINGS = 2 + LONGEST_DELAY + round(LONGEST_DELAY_S * Timing().current_loop_hz)
"""Readings in the plant's history: the longest delay, where a phase cycle is one tick."""

NOISE_CHANNEL = 1000
"""Channel of the noise of the first encoder; the others follow."""

SUBSTITUTIONS, AT_FIRST = 4, 40
"""How often a position is corrected by what is missing; the first row begins with nothing."""


def parameter_fields(encoders: int) -> list[tuple]:
    """
    Return the parameters of so many encoders.

    `counts_per_unit` is counts per m or rad of the minimal coordinate; zero where there is none.
    `encoder_imperfect` tells whether what follows it is looked at at all. Amplitudes, noise, loss and
    spacing of the marks in counts; `..._per_count` rad per count; `mark_spacing` zero: nothing is lost.
    """
    return [
        ('encoder_coordinate', 'i8', (encoders,)),
        ('counts_per_unit', 'f8', (encoders,)),
        ('encoder_divider', 'i8'),
        ('encoder_delay', 'i8', (encoders,)),
        ('encoder_imperfect', 'i8', (encoders,)),
        ('scale_error', 'f8', (encoders,)),
        ('eccentricity', 'f8', (encoders,)),
        ('eccentricity_per_count', 'f8', (encoders,)),
        ('eccentricity_phase', 'f8', (encoders,)),
        ('interpolation', 'f8', (encoders,)),
        ('interpolation_per_count', 'f8', (encoders,)),
        ('interpolation_phase', 'f8', (encoders,)),
        ('coarseness', 'f8', (encoders,)),
        ('delay_fraction', 'f8', (encoders,)),
        ('encoder_noise', 'f8', (encoders,)),
        ('encoder_noise_seed', 'i8', (encoders,)),
        ('loss_at_mark', 'f8', (encoders,)),
        ('mark_spacing', 'f8', (encoders,)),
    ]


def state_fields(encoders: int) -> list[tuple]:
    """
    Return the state of so many encoders.

    The last readings, in counts, the newest at place (tick / divider) mod `READINGS`; of imperfect
    encoders the position at the last reading and the counts lost so far, and between which marks it was.
    """
    return [
        ('readings', 'i8', (READINGS, encoders)),
        ('position_before', 'f8', (encoders,)),
        ('lost', 'f8', (encoders,)),
        ('between_marks', 'i8', (encoders,)),
    ]


def encoder_data(
    encoder: Encoder, ratio: float, common_delay: int, encoder_hz: float
) -> dict[str, Any]:
    """
    Return the parameters of an encoder by their names.

    `ratio` is motion of its coordinate over that of the minimal coordinate, `common_delay` the
    phase cycles by which all encoders are late, `encoder_hz` how many of these a second has. Raises
    `UserError` if these are so short that the history of readings does not reach back far enough.
    """
    counts = encoder.counts_per_unit
    errors = encoder.errors
    whole, fraction = 0, errors.delay_fraction
    if errors.delay != 0.0:
        late = errors.delay_fraction + errors.delay * encoder_hz
        whole = math.floor(late)
        fraction = late - whole
    if common_delay + errors.extra_delay + whole >= READINGS:
        longest = (READINGS - 1 - common_delay - errors.extra_delay) / encoder_hz
        raise UserError(
            f'encoders.{encoder.place}: delay_s: is {errors.delay:g}; with {encoder_hz:g} readings '
            f'per second it must be below {longest:g}'
        )
    return {
        'counts_per_unit': counts * ratio,
        'encoder_delay': common_delay + errors.extra_delay + whole,
        'encoder_imperfect': errors != type(errors)(),
        'scale_error': errors.scale,
        'eccentricity': errors.eccentricity.amplitude * counts,
        'eccentricity_per_count': 2.0 * math.pi / (errors.eccentricity.period * counts),
        'eccentricity_phase': errors.eccentricity.phase,
        'interpolation': errors.interpolation.amplitude,
        'interpolation_per_count': 2.0 * math.pi / errors.interpolation.period,
        'interpolation_phase': errors.interpolation.phase,
        'coarseness': errors.coarseness,
        'delay_fraction': fraction,
        'encoder_noise': errors.noise,
        'encoder_noise_seed': errors.noise_seed,
        'loss_at_mark': errors.lost_counts,
        'mark_spacing': errors.lost_every * abs(counts),
    }


@compiled
def read_encoder(p, position, encoder):
    """Return the whole counts of a perfect encoder at `position` (n,) of the coordinates."""
    coordinate = p['encoder_coordinate'][encoder]
    return np.int64(np.floor(p['counts_per_unit'][encoder] * position[coordinate]))


@compiled
def seen_counts(s, p, encoder):
    """
    Return what an encoder sees, in counts, before noise and rounding, at an encoder tick.

    To be called once for each encoder tick, in order: it counts the marks that were passed.
    """
    now = p['counts_per_unit'][encoder] * s['position'][p['encoder_coordinate'][encoder]]
    if not p['encoder_imperfect'][encoder]:
        return now
    seen = now + p['delay_fraction'][encoder] * (s['position_before'][encoder] - now)
    s['position_before'][encoder] = now
    if p['mark_spacing'][encoder] > 0.0:
        between = _between_marks(p, encoder, seen)
        passed = abs(between - s['between_marks'][encoder])
        s['between_marks'][encoder] = between
        s['lost'][encoder] += passed * p['loss_at_mark'][encoder]
    _, cosine = sine_and_cosine(
        p['eccentricity_per_count'][encoder] * seen - p['eccentricity_phase'][encoder]
    )
    seen = (1.0 + p['scale_error'][encoder]) * seen + p['eccentricity'][encoder] * cosine
    _, cosine = sine_and_cosine(
        p['interpolation_per_count'][encoder] * seen - p['interpolation_phase'][encoder]
    )
    return seen + p['interpolation'][encoder] * cosine - s['lost'][encoder]


@compiled
def find_positions(state, parameters, counts, position):
    """
    Fill `position` (rows, z): where encoders must be for each row of `counts` (rows, encoders) to be
    seen.

    That of the coordinates with an encoder, in their units; at rest, if `delay_fraction` is zero. By
    repeated substitution, begun with the error of the row before: it converges as errors of
    encoders change by much less than a count per count. Changes `state`.
    """
    s = state[0]
    p = parameters[0]
    for encoder in range(counts.shape[1]):
        per_unit = p['counts_per_unit'][encoder]
        if per_unit == 0.0:
            continue
        coordinate = p['encoder_coordinate'][encoder]
        correction = 0.0
        s['position'][coordinate] = counts[0, encoder] / per_unit
        fill_readings(s, p)
        for row in range(counts.shape[0]):
            ideal = counts[row, encoder] / per_unit
            for _ in range(SUBSTITUTIONS if row else AT_FIRST):
                s['position'][coordinate] = ideal + correction
                missing = counts[row, encoder] - seen_counts(s, p, encoder)
                correction += missing / per_unit
            position[row, coordinate] = ideal + correction


@compiled
def read_imperfect_encoder(s, p, encoder, reading):
    """Return the counts of an encoder with its imperfections at encoder tick number `reading`."""
    seen = seen_counts(s, p, encoder)
    if p['encoder_noise'][encoder] > 0.0:
        seed = p['encoder_noise_seed'][encoder]
        deviate = normal(seed, NOISE_CHANNEL + encoder, reading)
        seen += p['encoder_noise'][encoder] * deviate
    coarseness = p['coarseness'][encoder]
    return np.int64(np.floor(coarseness * np.floor(seen / coarseness)))


@compiled
def _between_marks(p, encoder, counts):
    """Return the number of the stretch between two marks, 0 about position zero."""
    return np.int64(np.floor(counts / p['mark_spacing'][encoder] + 0.5))


@compiled
def fill_readings(s, p):
    """Fill the history as if the machine had always stood where it is; no count lost so far."""
    for encoder in range(len(p['encoder_delay'])):
        count = read_encoder(p, s['position'], encoder)
        for place in range(READINGS):
            s['readings'][place, encoder] = count
        if not p['encoder_imperfect'][encoder]:
            continue
        now = p['counts_per_unit'][encoder] * s['position'][p['encoder_coordinate'][encoder]]
        s['position_before'][encoder] = now
        s['lost'][encoder] = 0.0
        if p['mark_spacing'][encoder] > 0.0:
            s['between_marks'][encoder] = _between_marks(p, encoder, now)
        for back in range(READINGS - 1, 0, -1):
            place = READINGS - back
            s['readings'][place, encoder] = read_imperfect_encoder(s, p, encoder, -back)


@compiled
def measure_counts(s, p, tick, counts):
    """
    Read the encoders if `tick` is an encoder tick, and publish the delayed counts into `counts`
    (encoders,).

    Between encoder ticks `counts` is left as it is.
    """
    if tick % p['encoder_divider'] != 0:
        return
    reading = tick // p['encoder_divider']
    newest = reading % READINGS
    for encoder in range(len(p['encoder_delay'])):
        if p['encoder_imperfect'][encoder]:
            s['readings'][newest, encoder] = read_imperfect_encoder(s, p, encoder, reading)
        else:
            s['readings'][newest, encoder] = read_encoder(p, s['position'], encoder)
        published = (reading - p['encoder_delay'][encoder]) % READINGS
        counts[encoder] = s['readings'][published, encoder]
