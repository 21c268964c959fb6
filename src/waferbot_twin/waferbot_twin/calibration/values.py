# SPDX-License-Identifier: Apache-2.0
"""What is sought: values by name, the bounds of each, and the shipped ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from waferbot_lockstep.marked_yaml import read
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean

Values = dict[str, float]

CALIBRATED = package_data('waferbot_twin', 'calibration', 'calibrated.yaml')
"""The values that the shipped machine and gains were made from, by stage and name."""


@dataclass(frozen=True)
class Unknown:
    """A value that is sought, within bounds that real parts set; SI units, in the name."""

    name: str
    low: float
    high: float


def calibrated(*stages: str) -> Values:
    """Return the values of these stages (default: of the nominal machine) as shipped."""
    content = read(CALIBRATED).data
    return {
        name: float(value)
        for stage in stages or ('payload', 'y_rotate')
        for name, value in content[stage].items()
    }


def started_from(path: Path) -> dict[str, Values]:
    """
    Return the values of every stage, those of a file in place of the shipped ones, by stage and name.

    The file has the form of `CALIBRATED`, as `waferbot calibrate --out` writes it, and may leave out
    stages and values. Raises `UserError` with file and line for a name that is none, or no number.
    """
    shipped = read(CALIBRATED).data
    document = read(path)
    for stage, values in document.data.items():
        if stage not in shipped:
            raise document.error((stage,), f'is no stage{did_you_mean(stage, shipped)}')
        if not isinstance(values, dict):
            raise document.error((stage,), 'must be a mapping of values')
        for name, value in values.items():
            if name not in shipped[stage]:
                raise document.error(
                    (stage, name), f'is no value of {stage}{did_you_mean(name, shipped[stage])}'
                )
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.error((stage, name), f'is {value!r}; it must be a number')
    return {
        stage: {
            name: float(document.data.get(stage, {}).get(name, value))
            for name, value in values.items()
        }
        for stage, values in shipped.items()
    }
