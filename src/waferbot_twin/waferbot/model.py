# SPDX-License-Identifier: Apache-2.0
"""Models: a machine with the settings of its controller and amplifiers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model_or_machine


@dataclass(frozen=True)
class Model:
    """
    A model of a machine; it is never changed in place.

    `variant` is the whole of it as plain data, for what this interface does not offer.
    """

    variant: Variant

    @property
    def name(self) -> str:
        """The model's name."""
        return self.variant.name

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of the axes that the machine has."""
        return tuple(self.variant.description.axes)

    @property
    def text(self) -> str:
        """The model as the text of one YAML file, which every node and engine loads."""
        return self.variant.text

    def save(self, file: str | Path) -> Path:
        """Write the model to a YAML file and return its path; raises `UserError` if that fails."""
        path = Path(file)
        try:
            path.write_text(self.text, 'utf-8')
        except OSError as error:
            raise UserError(f'{path} cannot be written: {error.strerror}') from error
        return path

    def __repr__(self) -> str:
        return f'Model({self.name!r})'


def load_model(name_or_path: str | Path) -> Model:
    """
    Return a model: the name of one that comes with the package, or a YAML file.

    A file may hold a model or the description of a machine alone, of which neither controller nor
    amplifier is known. Raises `UserError` for an unknown name or a file that is wrong.
    """
    return Model(Variant.of(load_model_or_machine(str(name_or_path))))
