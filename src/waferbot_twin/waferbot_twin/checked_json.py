# SPDX-License-Identifier: Apache-2.0
"""JSON that waferbot wrote and reads again: it may have been damaged or edited since."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import jsonschema

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import key_text

TEXT = {'type': 'string'}
WHOLE = {'type': 'integer', 'minimum': -(2**63), 'maximum': 2**63 - 1}
NUMBER = {'type': 'number', 'minimum': -1e300, 'maximum': 1e300}
"""Schemas of the usual values; the bounds are what arithmetic behind them can hold."""

_LONGEST = 200


def checked_json(text: str, schema: Mapping[str, Any], where: str) -> Any:
    """
    Return what a JSON text holds if it fits a JSON schema.

    Raises `UserError` that begins with `where` (the file, or the attachment of one) and names the key.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f'{where} is damaged: it is no JSON ({error})') from None
    wrong = next(jsonschema.Draft202012Validator(schema).iter_errors(value), None)
    if wrong is not None:
        key = key_text(tuple(wrong.absolute_path))
        reason = wrong.message
        if len(reason) > _LONGEST:
            reason = f'{reason[:_LONGEST]} ...'
        raise UserError(f'{where} is damaged: {key + ": " if key else ""}{reason}')
    return value
