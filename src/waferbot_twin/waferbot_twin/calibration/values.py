# SPDX-License-Identifier: Apache-2.0
"""What is sought: values by name, the bounds of each, and the shipped ones."""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_lockstep.marked_yaml import read
from waferbot_lockstep.package_data import package_data

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
