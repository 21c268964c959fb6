# SPDX-License-Identifier: Apache-2.0
"""
Models: which machine, with which controller and amplifier settings.

A model is a ROS 2 parameter file with one section per node. It holds what differs from the settings
that come with the packages (`waferbot_pmac/config/pmac.yaml`, `waferbot_copley/config/amplifiers.yaml`),
so a node started by hand takes those first and the model second:

    /**/plant:
      ros__parameters: {description: rigid, damping: improved}
    /**/pmac:
      ros__parameters:
        y_linear: {Ixx30: 2000}

Names of shipped models are the file names in `waferbot_twin/config/models`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from waferbot_copley.node_settings import COPLEY_PARAMETERS
from waferbot_copley.settings import settings_of
from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED as SHIPPED_LAYOUT
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.marked_yaml import Document, Key, parse, read
from waferbot_lockstep.node_settings import NODE_PARAMETERS
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import Parameter, did_you_mean
from waferbot_plant.description import Description
from waferbot_plant.description_file import described_layout, load_description
from waferbot_plant.node_settings import PLANT_PARAMETERS
from waferbot_plant.plant import description_names, description_source
from waferbot_pmac.compensation import Table, load_tables, read_text
from waferbot_pmac.i_variables import axis_parameters
from waferbot_twin.recording.reader import Recording

DESCRIPTION_KEYS = frozenset({'bodies', 'joints', 'extends'})
"""Keys by which the description of a machine is known from a file of parameters."""

NODES = ('plant', 'pmac', 'copley')

SHIPPED = 'rigid'
"""The model of the shipped machine that tells what is usual: speeds, accelerations, strokes."""


_OF_NODE: dict[str, tuple[str, ...]] = {
    'plant': PLANT_PARAMETERS,
    'pmac': ('experiment', 'compensation'),
    'copley': COPLEY_PARAMETERS,
}
_OF_AXIS: dict[str, Callable[[str, Layout], Iterable[Parameter]]] = {
    'pmac': axis_parameters,
    'copley': settings_of,
}
"""Parameters that a node has beside those of all nodes: of its own, and of each axis."""


@dataclass(frozen=True)
class Model:
    """A model: its name, where it came from, and the parameters of each node."""

    name: str
    path: Path
    parameters: dict[str, dict[str, Any]]

    @property
    def text(self) -> str:
        """The whole model as one ROS 2 parameter file, with the settings of the packages in it."""
        sections = {
            f'/**/{node}': {'ros__parameters': parameters}
            for node, parameters in self.parameters.items()
        }
        return yaml.safe_dump(sections, sort_keys=False)

    @property
    def description(self) -> str:
        """The machine: name, path or text of its description."""
        return str(self.parameters['plant'].get('description', 'rigid'))

    @cached_property
    def layout(self) -> Layout:
        """The axes and encoders of the machine; raises `UserError`."""
        return described_layout(description_source(self.description))

    @property
    def axis_units(self) -> dict[str, str]:
        """Unit of each axis' position, `m` or `rad`, as the machine has it; raises `UserError`."""
        return self._machine.axis_units

    @property
    def titles(self) -> Mapping[str, str]:
        """What reports and plots call the axes, as the machine says; raises `UserError`."""
        return self._machine.titles

    @property
    def _machine(self) -> Description:
        return load_description(description_source(self.description))

    def with_settings(self, node: str, settings: Mapping[str, Any]) -> Model:
        """Return the model with other settings of one node laid over its own."""
        parameters = copy.deepcopy(self.parameters)
        _lay_over(parameters[node], settings)
        return replace(self, parameters=parameters)

    @property
    def compensation(self) -> tuple[Table, ...]:
        """The tables by which the PMAC adds currents; raises `UserError` for what is wrong in them."""
        text = str(self.parameters['pmac'].get('compensation') or '')
        return load_tables(text, self.axis_units) if text else ()

    def of_axes(self, node: str) -> dict[str, dict[str, Any]]:
        """Return the settings per axis of a node, without those that are not an axis'."""
        return {axis: self.parameters[node].get(axis, {}) for axis in self.layout.axes}


def models_folder() -> Path:
    """Return the folder of the shipped models."""
    return package_data('waferbot_twin', 'config', 'models')


def model_names() -> list[str]:
    """Return the names of the shipped models."""
    return sorted(path.stem for path in models_folder().glob('*.yaml'))


def load_model(name_or_path: str) -> Model:
    """
    Return a shipped model by name, or a model from a file.

    Raises `UserError` for an unknown name, and for a file that is no ROS 2 parameter file for the
    nodes `plant`, `pmac` and `copley` or names a parameter that they do not have; the values are
    checked by what uses them.
    """
    path = Path(name_or_path)
    if path.suffix not in ('.yaml', '.yml') and not path.exists():
        path = models_folder() / f'{name_or_path}.yaml'
        if not path.exists():
            names = model_names()
            raise UserError(
                f'there is no model {name_or_path!r}{did_you_mean(name_or_path, names)} '
                f'(shipped: {", ".join(names)}; or give a YAML file)'
            )
    parameters: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    document = read(path)
    layout = _layout_in(document)
    # Settings of the packages are those of the axes of the shipped machine.
    base = [read(file) for file in base_files()] if layout == SHIPPED_LAYOUT else []
    for one in (*base, document):
        for node, section in _sections(one, layout).items():
            _lay_over(parameters[node], section)
    _take_in_compensation(parameters['pmac'], path.parent)
    return Model(path.stem, path, parameters)


def _take_in_compensation(pmac: dict[str, Any], folder: Path) -> None:
    """Put the text of a file of compensation tables, named from the model's folder, in its place."""
    named = str(pmac.get('compensation') or '')
    if named and '\n' not in named:
        pmac['compensation'] = read_text(folder / named)


def load_model_or_machine(name_or_path: str) -> Model:
    """
    Return a model, or a machine alone: a description by name or path, without any settings.

    Such a machine has neither controller nor amplifier that anything is known of. Raises `UserError`.
    """
    path = Path(name_or_path)
    if path.is_file():
        data = read(path).data
        alone = isinstance(data, dict) and not DESCRIPTION_KEYS.isdisjoint(data)
    else:
        alone = name_or_path not in model_names() and name_or_path in description_names()
    if not alone:
        return load_model(name_or_path)
    return Model(
        path.stem, path, {'plant': {'description': name_or_path}, 'pmac': {}, 'copley': {}}
    )


def recorded_model(recording: Recording) -> Model:
    """Return the model that a recording was made with; raises `UserError` if it does not say."""
    text = recording.attachments.get('model.yaml')
    if text is None:
        raise UserError(f'{recording.path} does not hold its model; give --model')
    where = recording.path / 'model.yaml'
    if 'machine.yaml' in recording.attachments:
        layout = described_layout(recording.attachments['machine.yaml'])
    else:
        layout = SHIPPED_LAYOUT
    sections = _sections(parse(text, str(where)), layout)
    parameters = {node: sections.get(node, {}) for node in NODES}
    if 'machine.yaml' in recording.attachments:
        # The machine as it was then; a file of that name may have changed since.
        parameters['plant']['description'] = recording.attachments['machine.yaml']
    return Model(str(recording.run.get('model', 'recorded')), where, parameters)


def recorded_titles(recording: Recording) -> Mapping[str, str]:
    """
    Return what the axes of a recording are called: as its machine says, as usual if it holds none.

    An imported log is of a machine that it does not tell of.
    """
    known = 'model.yaml' in recording.attachments
    return recorded_model(recording).titles if known else USUAL_TITLES


def base_files() -> tuple[Path, ...]:
    """Return the parameter files that every model begins with."""
    return (
        package_data('waferbot_pmac', 'config', 'pmac.yaml'),
        package_data('waferbot_copley', 'config', 'amplifiers.yaml'),
    )


def _layout_in(document: Document) -> Layout:
    """Return the axes and encoders of the machine that a model names; raises `UserError`."""
    sections = document.data if isinstance(document.data, dict) else {}
    named = 'rigid'
    for key, section in sections.items():
        inner = section.get('ros__parameters') if isinstance(section, dict) else None
        if str(key).rsplit('/', 1)[-1] == 'plant' and isinstance(inner, dict):
            named = str(inner.get('description', named))
    return described_layout(description_source(named))


def _sections(document: Document, layout: Layout) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in a ROS 2 parameter file, for a machine with these axes."""
    if not isinstance(document.data, dict):
        raise UserError(
            f'{document.place()}: a model is a ROS 2 parameter file with sections per node'
        )
    sections: dict[str, dict[str, Any]] = {}
    for key, section in document.data.items():
        node = str(key).rsplit('/', 1)[-1]
        if node not in NODES:
            raise UserError(
                f'{document.place((key,))}: {_no_section(document, key, node, layout)}'
            )
        if not isinstance(section, dict) or set(section) != {'ros__parameters'}:
            raise UserError(
                f'{document.place((key,))}: section {key!r} must have the one key ros__parameters'
            )
        parameters = section['ros__parameters'] or {}
        if not isinstance(parameters, dict):
            raise document.error((key, 'ros__parameters'), 'must be a mapping of names to values')
        place = (key, 'ros__parameters')
        _lay_over(sections.setdefault(node, {}), _known(document, place, node, parameters, layout))
    return sections


def _no_section(document: Document, key: str, node: str, layout: Layout) -> str:
    """Return what is wrong with a section of a model that is for no node."""
    if not DESCRIPTION_KEYS.isdisjoint(document.data):
        return (
            'this describes a machine alone; a model says which one with '
            '/**/plant: {ros__parameters: {description: FILE}}'
        )
    wrong = f'section {key!r} is for no node of the twin (nodes: {", ".join(NODES)})'
    for owner in NODES:
        inner = (*_OF_NODE[owner], *(layout.axes if owner in _OF_AXIS else ()))
        near = ';' if key in inner else did_you_mean(key, inner)
        if near:
            return f'{wrong}{near} It stands below /**/{owner}: ros__parameters:'
    return wrong + did_you_mean(node, NODES)


def _known(
    document: Document, place: Key, node: str, parameters: Mapping[str, Any], layout: Layout
) -> dict[str, Any]:
    """
    Return parameters of a node, mapping by mapping; `y_linear.Ixx30: 1` is what ROS takes, too.

    Raises `UserError` for a name that the node does not have.
    """
    axes = layout.axes if node in _OF_AXIS else ()
    nested: dict[str, Any] = {}
    for name, value in parameters.items():
        axis, dot, inner = name.partition('.')
        if axis not in axes:
            known = (*axes, *_OF_NODE[node], *NODE_PARAMETERS)
            if name not in known:
                raise document.error(
                    (*place, name), f'{node} has no such parameter{did_you_mean(name, known)}'
                )
            nested[name] = value
            continue
        settings = {inner: value} if dot else value
        if not isinstance(settings, dict):
            raise document.error((*place, name), 'must be a mapping of names to values')
        settings_known = [setting.name for setting in _OF_AXIS[node](axis, layout)]
        for setting in settings:
            if setting not in settings_known:
                raise document.error(
                    (*place, name) if dot else (*place, name, setting),
                    f'{node} has no setting {setting!r} of an axis'
                    f'{did_you_mean(setting, settings_known)}',
                )
        _lay_over(nested.setdefault(axis, {}), settings)
    return nested


def _lay_over(below: dict[str, Any], above: Mapping[str, Any]) -> None:
    """Put the values of `above` into `below`, mapping by mapping, as ROS does with several files."""
    for key, value in above.items():
        if isinstance(value, dict) and isinstance(below.get(key), dict):
            _lay_over(below[key], value)
        else:
            below[key] = copy.deepcopy(value)
