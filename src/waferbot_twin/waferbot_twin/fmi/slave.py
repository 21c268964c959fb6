# SPDX-License-Identifier: Apache-2.0
"""
What runs inside an FMU: a block of the twin behind the calls of FMI.

The FMU's resources hold the model (`model.yaml`), `block.json` (kind, name, parameters, identity) and
the sources of waferbot. Parameters take effect when the block is built, at the end of initialisation.
A step must be a whole number of ticks of 1/18000 s; inputs are held over it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_twin.effects.variant import Variant
from waferbot_twin.fmi.blocks import BLOCKS, Block, variables_of
from waferbot_twin.fmi.loader import release_at_exit
from waferbot_twin.identification.named_parameters import parse
from waferbot_twin.models import load_model

AS_WHOLE = 1e-6
"""How far a step may be from a whole number of ticks, in ticks."""


class Runner:
    """A block with its inputs, outputs and parameters by name, built when it is needed."""

    def __init__(self, resources: str | Path) -> None:
        """Read what the FMU holds; raises `UserError`."""
        folder = Path(resources)
        release_at_exit(folder)
        self.about: dict[str, Any] = json.loads((folder / 'block.json').read_text('utf-8'))
        self.variant = Variant.of(load_model(str(folder / 'model.yaml')))
        self.timing = Timing()
        self.input_variables, self.output_variables = variables_of(
            self.about['kind'], self.variant.description.axis_units, self.variant.layout
        )
        self.input_names = [variable.name for variable in self.input_variables]
        self.output_names = [variable.name for variable in self.output_variables]
        self.named = {path: parse(path, self.variant) for path in self.about['parameters']}
        self.parameters = {path: one.start for path, one in self.named.items()}
        self.inputs = np.zeros(len(self.input_names))
        self._block: Block | None = None
        self._outputs = np.zeros(len(self.output_names))

    def build(self) -> None:
        """Build the block with the parameters as they are; raises `UserError`."""
        variant = self.variant
        for path, one in self.named.items():
            if self.parameters[path] != one.start:
                variant = variant.with_overlay(one.overlay(variant, self.parameters[path]))
        self._block = BLOCKS[self.about['kind']](variant, self.timing)
        self._outputs[:] = self._block.values()

    def output(self, place: int) -> float:
        """Return an output."""
        return float(self._outputs[place])

    def step(self, step_s: float) -> bool:
        """Advance; False if the step is no whole number of ticks."""
        ticks = round(step_s / self.timing.tick_s)
        if ticks < 1 or abs(step_s / self.timing.tick_s - ticks) > AS_WHOLE:
            return False
        if self._block is None:
            self.build()
        assert self._block is not None
        for _ in range(ticks):
            self._block.step(self.inputs)
        self._outputs[:] = self._block.values()
        return True
