# SPDX-License-Identifier: Apache-2.0
"""
Write a part of the twin as an FMU for co-simulation, FMI 3.0 or 2.0.

The FMU holds the model, the sources of waferbot and the loader of pythonfmu3 (or pythonfmu), which
runs them in a Python that the importing tool provides or finds: `REQUIREMENTS` must be installed there.
The first run on a machine compiles for half a minute.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import shutil
import sys
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.timing import Timing
from waferbot_twin.effects.variant import Variant
from waferbot_twin.fmi.blocks import BLOCKS
from waferbot_twin.identification.named_parameters import parse_all
from waferbot_twin.version import VERSION

REQUIREMENTS = (
    'jinja2', 'joblib', 'jsonschema', 'matplotlib', 'mcap', 'numba', 'numpy', 'pandas', 'PyYAML',
    'rich', 'rosbags', 'scipy', 'sympy', 'zstandard',
)  # fmt: skip
"""Packages that a Python must have to run the FMU."""

PACKAGES = (
    'waferbot_lockstep', 'waferbot_plant', 'waferbot_pmac', 'waferbot_copley', 'waferbot_twin',
)  # fmt: skip
LEFT_OUT = shutil.ignore_patterns('__pycache__', 'demo', 'page', 'test')

BUILDERS = {'3': 'pythonfmu3', '2': 'pythonfmu'}

BASE_UNITS: dict[str, dict[str, int]] = {
    'V': {'kg': 1, 'm': 2, 's': -3, 'A': -1},
    'A': {'A': 1},
    'm': {'m': 1},
    'rad': {'rad': 1},
    'm/s': {'m': 1, 's': -1},
    'rad/s': {'rad': 1, 's': -1},
    'count': {},
}
"""Units of the variables, by exponents of SI's."""


def export(
    variant: Variant, kind: str, parameters: Sequence[str], fmi: str, file: Path
) -> dict[str, Any]:
    """
    Write `file`, an FMU of a block (`blocks.KINDS`) of a model; return what is in it.

    `parameters` are paths as `identify` takes them; `fmi` is '3' or '2'. Raises `UserError` if the
    builder is not installed, or the model cannot be built.
    """
    builder = _builder(fmi)
    named = parse_all(parameters, variant)
    BLOCKS[kind](variant, Timing())
    name = f'Waferbot{kind.capitalize()}Fmi{fmi}'
    about = {
        'kind': kind,
        'name': name,
        'fmi': fmi,
        'model': variant.name,
        'version': VERSION,
        'parameters': [one.path for one in named],
        'units': BASE_UNITS,
    }
    about['identity'] = str(_identity(variant.text, json.dumps(about, sort_keys=True)))
    with tempfile.TemporaryDirectory(prefix='waferbot-fmu-') as place:
        folder = Path(place)
        script = folder / f'{name}.py'
        template = package_data('waferbot_twin', 'fmi', f'slave_fmi{fmi}.py.txt')
        script.write_text(template.read_text('utf-8').replace('CLASS_NAME', name), 'utf-8')
        resources = [folder / 'model.yaml', folder / 'block.json', folder / 'requirements.txt']
        contents = (variant.text, json.dumps(about, indent=1), '\n'.join(REQUIREMENTS) + '\n')
        for path, content in zip(resources, contents, strict=True):
            path.write_text(content, 'utf-8')
        for package in PACKAGES:
            target = folder / package
            shutil.copytree(package_data(package), target, ignore=LEFT_OUT)
            resources.append(target)
        with _WithoutTraces(name):
            built = builder.FmuBuilder.build_FMU(
                script, dest=folder / 'built', project_files=resources
            )
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            shutil.copyfile(built, file)
        except OSError as error:
            raise UserError(f'{file} cannot be written: {error.strerror}') from error
    return about


class _WithoutTraces:
    """Leave `sys.path` and `sys.modules` as they were: a builder imports the script."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __enter__(self) -> None:
        self._path = list(sys.path)

    def __exit__(self, *error: object) -> None:
        sys.path[:] = self._path
        sys.modules.pop(self._module, None)


def _builder(fmi: str) -> Any:
    try:
        return importlib.import_module(f'{BUILDERS[fmi]}.builder')
    except ImportError as error:
        raise UserError(
            f'FMI {fmi} needs {BUILDERS[fmi]}: python -m pip install {BUILDERS[fmi]}'
        ) from error


def _identity(*texts: str) -> uuid.UUID:
    """Return an identity that is the same for the same content."""
    return uuid.UUID(bytes=hashlib.sha256('\0'.join(texts).encode()).digest()[:16])
