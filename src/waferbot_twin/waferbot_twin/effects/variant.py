# SPDX-License-Identifier: Apache-2.0
"""
A model that effects can be laid over: machine, controller and amplifier settings as plain data.

An effect changes a model by an `Overlay`, which says what differs in the machine's description, in
the I-variables and in the amplifiers' settings. Laid over one another, overlays become a model
that every engine runs, and a file that every node loads.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from waferbot_copley.settings import settings_of as amplifier_settings
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.marked_yaml import SAFE_DUMPER, Document, merged, parse
from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import Assembly, assemble
from waferbot_plant.description import Description
from waferbot_plant.description_file import check, load_description, whole_text
from waferbot_plant.plant import Machine, description_source
from waferbot_pmac.compensation import Table, load_tables
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.models import Model

Settings = dict[str, dict[str, Any]]
"""Settings per axis."""


@dataclass(frozen=True)
class Overlay:
    """What an effect changes: a part of a description, and settings by axis and name."""

    machine: Mapping[str, Any] = field(default_factory=dict)
    pmac: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    copley: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    """How far parameters are off, in the standard deviations that they usually have."""
    skew_s: Mapping[str, float] = field(default_factory=dict)
    """How much later than the position the drive of an axis stands in logs, more than is known."""
    between_s: Mapping[str, float] = field(default_factory=dict)
    """How much earlier a drive does what it does between two samples of a log than the log is taken."""


@dataclass(frozen=True)
class Variant:
    """A model as data. `machine` is the whole description; it is never changed in place."""

    name: str
    machine: Mapping[str, Any]
    damping: str
    pmac: Settings
    copley: Settings
    node_settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    origin: Variant | None = field(default=None, repr=False, compare=False)
    usual_current: Mapping[str, float] = field(default_factory=dict)
    """RMS current (A) of each axis in logs, where nothing is known of an amplifier."""
    usual_speed: Mapping[str, float] = field(default_factory=dict)
    """Largest speed (m/s or rad/s) of each axis in logs that were brought in."""
    force_driven: frozenset[str] = frozenset()
    """Axes whose logs have the force and no current: what a motor makes of one is not in them."""
    told_alone: frozenset[str] = frozenset()
    """Axes whose logs have what the drive is told or reckons, and no measured current."""
    brought_in: frozenset[str] = frozenset()
    """Axes whose logs were brought in: drive and position may have times of their own there."""
    deviations: Mapping[str, float] = field(default_factory=dict)
    """Parameters that are off, each in the standard deviations that it usually has (`Overlay`)."""
    skew_s: Mapping[str, float] = field(default_factory=dict)
    """Of logs, not of the machine: how late the drive of an axis stands in them (`Overlay`)."""
    between_s: Mapping[str, float] = field(default_factory=dict)
    """Likewise: how early it is between their samples."""

    @property
    def base(self) -> Variant:
        """The model before anything was laid over it: what effects are sized by."""
        return self.origin or self

    @classmethod
    def of(cls, model: Model) -> Variant:
        """Return a model as a variant; raises `UserError` for a description that is wrong."""
        damping = str(model.parameters['plant'].get('damping', 'improved'))
        source = description_source(model.description)
        load_description(source, damping=damping)  # it tells in which line something is wrong
        machine = parse(whole_text(source), model.description.split('\n', 1)[0]).data
        others = {
            node: {key: value for key, value in settings.items() if key not in model.layout.axes}
            for node, settings in model.parameters.items()
        }
        return cls(
            model.name,
            machine,
            damping,
            {axis: dict(values) for axis, values in model.of_axes('pmac').items()},
            {axis: dict(values) for axis, values in model.of_axes('copley').items()},
            others,
        )

    def with_overlay(self, overlay: Overlay) -> Variant:
        """Return the variant with an overlay laid over it; raises `UserError`."""
        return replace(
            self,
            machine=merged(self.machine, overlay.machine, 'effect'),
            pmac=_laid_over(self.pmac, overlay.pmac),
            copley=_laid_over(self.copley, overlay.copley),
            origin=self.base,
            deviations={**self.deviations, **overlay.deviations},
            skew_s={**self.skew_s, **overlay.skew_s},
            between_s={**self.between_s, **overlay.between_s},
        )

    def in_finer_steps(self, times: int) -> Variant:
        """Return the variant with so many times as many steps of the plant in a tick."""
        steps = times * int(self.machine.get('substeps', 1))
        return replace(self, machine={**self.machine, 'substeps': steps})

    @cached_property
    def description(self) -> Description:
        """The machine, checked."""
        document = Document(dict(self.machine), {(): (self.name, 1)})
        return check(document, self.damping)

    @property
    def layout(self) -> Layout:
        """The axes and encoders of the machine, in the order of their places."""
        return self.description.layout

    @property
    def titles(self) -> Mapping[str, str]:
        """What reports and plots call the axes."""
        return self.description.titles

    @cached_property
    def rigid(self) -> Assembly:
        """The machine with every connection rigid: what moves with what, and how much of it."""
        return assemble(with_rigid(self.description, self.description.connections))

    @cached_property
    def as_connected(self) -> Assembly:
        """The machine with its connections as they are."""
        return assemble(self.description)

    @cached_property
    def compensation(self) -> tuple[Table, ...]:
        """The tables by which the PMAC adds currents."""
        text = str(self.node_settings.get('pmac', {}).get('compensation') or '')
        return load_tables(text, self.description.axis_units)

    @cached_property
    def _servo(self) -> np.void:
        return servo_parameters(self.pmac, self.name, self.layout)[0]

    def build(self, timing: Timing) -> Machine:
        """Return the machine, assembled."""
        return Machine(self.description, self.as_connected, timing)

    def i_variable(self, axis: str, name: str) -> float:
        """Return an I-variable of an axis, its default where it is not set."""
        return float(self._servo[name][self.layout.place(axis)])

    def amplifier_setting(self, axis: str, name: str) -> float:
        """Return a setting of an axis' amplifier, its default where it is not set."""
        if name in self.copley.get(axis, {}):
            return float(self.copley[axis][name])
        for setting in amplifier_settings(axis, self.layout):
            if setting.name == name:
                return float(setting.default)
        raise UserError(f'an amplifier has no setting {name!r}')

    def model(self) -> Model:
        """Return the variant as a model that the engines run."""
        parameters = {
            'plant': {**self.node_settings.get('plant', {}), 'description': self.machine_text},
            'pmac': {**self.node_settings.get('pmac', {}), **copy.deepcopy(self.pmac)},
            'copley': {**self.node_settings.get('copley', {}), **copy.deepcopy(self.copley)},
        }
        parameters['plant']['damping'] = self.damping
        return Model(self.name, Path(f'{self.name}.yaml'), parameters)

    @property
    def is_machine_alone(self) -> bool:
        """Whether nothing is known of a controller or an amplifier of any axis."""
        return not any(self.pmac.values()) and not any(self.copley.values())

    @property
    def text(self) -> str:
        """The variant as the text of a file that --model takes: a model, or a machine alone."""
        return self.machine_text if self.is_machine_alone else self.model().text

    @property
    def machine_text(self) -> str:
        """The description as the text of one YAML file."""
        return yaml.dump(dict(self.machine), Dumper=_WithoutAliases, sort_keys=False)


def with_rigid(description: Description, names: Iterable[str]) -> Description:
    """Return a description in which these connections do not give."""
    rigid = {name: replace(description.connections[name], flexible=False) for name in names}
    return replace(description, connections={**description.connections, **rigid})


def built(variant: Variant, timing: Timing) -> Machine:
    """Return the machine of a variant; the last few are kept: a variant meets several logs."""
    return _built(Itself(variant), timing)


class Itself:
    """A variant that equals no other one, however alike: a key that costs nothing to compare."""

    def __init__(self, variant: Variant) -> None:
        self.variant = variant

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and other.variant is self.variant

    def __hash__(self) -> int:
        return id(self.variant)


@functools.lru_cache(maxsize=4)
def _built(variant: Itself, timing: Timing) -> Machine:
    return variant.variant.build(timing)


class _WithoutAliases(SAFE_DUMPER):
    """Writes out what stands in two places; our reader takes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _laid_over(below: Settings, above: Mapping[str, Mapping[str, Any]]) -> Settings:
    result = {axis: dict(values) for axis, values in below.items()}
    for axis, values in above.items():
        result.setdefault(axis, {}).update(values)
    return result
