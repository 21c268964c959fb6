# SPDX-License-Identifier: Apache-2.0
"""A comparison of frequency responses in words, as JSON and as a picture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from waferbot_twin.frequency_response.compare import Comparison
from waferbot_twin.frequency_response.estimate import Array, ComplexArray, FrequencyResponse
from waferbot_twin.frequency_response.peaks import (
    EXTRA,
    MATCHED,
    MISSING,
    NOT_JUDGED,
    RESONANCE,
)

SCHEMA = 1
MEASURED_COLOUR, MODEL_COLOUR = '#222222', '#c46a1b'
VERDICT_COLOURS = {MISSING: '#b5401f', EXTRA: '#7a3fa0', NOT_JUDGED: '#999999'}


def sentence(comparison: Comparison) -> str:
    """Return which resonances the model lacks and which it has too many, in words."""
    if comparison.simulated is None:
        return 'There is no simulation to compare with.'
    parts = []
    for verdict, text in ((MISSING, 'lacks'), (EXTRA, 'has, other than the machine,')):
        found = [
            f'{pair.frequency_hz:.4g} Hz'
            for pair in comparison.pairs
            if pair.verdict == verdict and pair.kind == RESONANCE
        ]
        if found:
            plural = 's' if len(found) > 1 else ''
            parts.append(f'{text} the resonance{plural} at {", ".join(found)}')
    if parts:
        return f'Model {comparison.model} {" and ".join(parts)}.'
    if any(pair.verdict == MATCHED and pair.kind == RESONANCE for pair in comparison.pairs):
        return f'Model {comparison.model} has the resonances that were measured, and no other.'
    return 'No resonance stands out where measurement and model are reliable.'


def how(response: FrequencyResponse) -> str:
    """Return in words how a response was estimated, and where it is known."""
    looks = {
        'periods': f'{response.degrees + 1} periods of a periodic command; scatter is noise, '
        'distortion by friction or play is not in it',
        'realisations': f'{response.degrees + 1} realisations of a periodic command; scatter is noise '
        'and distortion',
        'tapers': f'{response.degrees + 1} looks through orthogonal tapers',
    }[response.looks]
    through = {
        'indirect': 'through the commanded position (Syr / Sxr)',
        'direct': 'direct (Syx / Sxx)',
    }[response.method]
    known = response.frequency_hz[response.reliable]
    where = 'nowhere'
    if len(known):
        share = len(known) / np.count_nonzero(
            (response.frequency_hz >= known[0]) & (response.frequency_hz <= known[-1])
        )
        where = f'at {share:.0%} of the lines from {known[0]:.4g} to {known[-1]:.4g} Hz'
    return f'{through}, {looks}; resolution {response.resolution_hz:.3g} Hz; reliable {where}'


def as_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as plain values (schema 1); responses at every frequency included."""
    simulated = comparison.simulated
    return {
        'schema': SCHEMA,
        'logs': list(comparison.logs),
        'model': comparison.model,
        'from': comparison.channels[0].name,
        'to': comparison.channels[1].name,
        'unit': comparison.unit,
        'sentence': sentence(comparison),
        'notes': list(comparison.notes),
        'peaks': [
            {
                'kind': pair.kind,
                'verdict': pair.verdict,
                'frequency_hz': pair.frequency_hz,
                'shift_percent': pair.shift_percent,
                'measured': asdict(pair.measured) if pair.measured else None,
                'model': asdict(pair.model) if pair.model else None,
            }
            for pair in comparison.pairs
        ],
        'measured': _response(comparison.measured),
        'simulated': _response(simulated) if simulated is not None else None,
    }


def _response(response: FrequencyResponse) -> dict[str, Any]:
    return {
        'method': response.method,
        'looks': response.looks,
        'degrees_of_freedom': response.degrees,
        'resolution_hz': response.resolution_hz,
        'frequency_hz': response.frequency_hz.tolist(),
        'magnitude': np.abs(response.value).tolist(),
        'phase_deg': np.angle(response.value, deg=True).tolist(),
        'radius95': response.radius().tolist(),
        'noise_deviation': None if response.noise is None else response.noise.tolist(),
        'coherence': response.coherence.tolist(),
        'reliable': response.reliable.tolist(),
    }


def draw(comparison: Comparison, file: Path) -> None:
    """Draw magnitude, phase and coherence into an image file."""
    figure, panels = plt.subplots(
        3, 1, figsize=(10.0, 9.0), sharex=True, height_ratios=(5, 3, 2), layout='constrained'
    )
    magnitude, phase, coherence = panels
    shown = [('measured', comparison.measured, MEASURED_COLOUR)]
    if comparison.simulated is not None:
        shown.append((f'model {comparison.model}', comparison.simulated, MODEL_COLOUR))
    for name, response, colour in shown:
        _draw_magnitude(magnitude, response, colour, f'{name}, 95 % band')
        sure = response.reliable
        phase.plot(response.frequency_hz, _phase(response.value, sure), color=colour, lw=1.0)
        coherence.plot(response.frequency_hz, response.coherence, color=colour, lw=0.9)
    if comparison.linear is not None:
        frequency = comparison.measured.frequency_hz
        style = {'color': MODEL_COLOUR, 'lw': 0.8, 'ls': ':'}
        label = f'model {comparison.model}, linearised, without friction'
        magnitude.plot(frequency, np.abs(comparison.linear), label=label, **style)
        phase.plot(frequency, _phase(comparison.linear), **style)
    _draw_peaks(magnitude, comparison)
    source, target = comparison.channels
    magnitude.set(
        xscale='log',
        yscale='log',
        ylabel=f'magnitude [{comparison.unit}]',
        ylim=_limits(comparison),
    )
    phase.set(ylabel='phase [°]', ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    coherence.set(ylabel='coherence', ylim=(0, 1.05), xlabel='frequency [Hz]')
    coherence.xaxis.set_major_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    coherence.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(3, 0.5)))
    for panel in panels:
        panel.grid(which='both', alpha=0.25)
        panel.set_xlim(comparison.measured.frequency_hz[[0, -1]])
    magnitude.legend(fontsize=8, loc='best')
    figure.suptitle(
        f'{comparison.titles[source.axis]}: {source.kind} to {_other(comparison)}{target.kind}, '
        f'{", ".join(comparison.logs)}',
        fontsize=11,
    )
    figure.savefig(file, dpi=110, metadata={'Software': 'waferbot'})
    plt.close(figure)


def _other(comparison: Comparison) -> str:
    source, target = comparison.channels
    return '' if source.axis == target.axis else f'{comparison.titles[target.axis]} '


def _where(mask: np.ndarray, values: Array) -> Array:
    return np.where(mask, values, np.nan)


def _phase(value: ComplexArray, sure: NDArray[np.bool_] | bool = True) -> Array:
    """Return the phase in degrees, without the stroke from 180 to -180."""
    phase = np.angle(value, deg=True)
    jumps = np.abs(np.diff(phase, prepend=phase[:1])) > 270.0
    return np.where(sure & ~jumps, phase, np.nan)


def _draw_magnitude(panel: Axes, response: FrequencyResponse, colour: str, label: str) -> None:
    """Draw a magnitude with its band; faint where it is not reliable."""
    size, radius = np.abs(response.value), response.radius()
    sure = response.reliable
    panel.plot(response.frequency_hz, size, color=colour, lw=0.6, alpha=0.25)
    panel.plot(response.frequency_hz, _where(sure, size), color=colour, lw=1.2, label=label)
    panel.fill_between(
        response.frequency_hz, _where(sure, size - radius), _where(sure, size + radius),
        color=colour, alpha=0.2, lw=0,
    )  # fmt: skip


def _draw_peaks(panel: Axes, comparison: Comparison) -> None:
    """Mark every peak: up a resonance, down an anti-resonance; in colour where the model differs."""
    for pair in comparison.pairs:
        peak = pair.measured or pair.model
        assert peak is not None
        mark = '^' if pair.kind == RESONANCE else 'v'
        panel.plot(
            peak.frequency_hz, peak.magnitude, mark, ms=7, mfc='none',
            color=VERDICT_COLOURS.get(pair.verdict, '#2f7d32'),
        )  # fmt: skip
    done = {pair.verdict for pair in comparison.pairs}
    for verdict in sorted(done):
        panel.plot(
            [], [], '^', mfc='none', color=VERDICT_COLOURS.get(verdict, '#2f7d32'), label=verdict
        )


def _limits(comparison: Comparison) -> tuple[float, float]:
    """Return limits of the magnitude that hold what is reliable."""
    sizes = [
        np.abs(response.value)[response.reliable]
        for response in (comparison.measured, comparison.simulated)
        if response is not None
    ]
    every = np.concatenate(sizes)
    if len(every) == 0:
        every = np.abs(comparison.measured.value)
    return float(every.min()) / 2.0, float(every.max()) * 2.0
