# SPDX-License-Identifier: Apache-2.0
"""
Write ``generated.py`` from the symbolic derivation: ``python -m
waferbot_plant.lagrange.generate``.

Common subexpressions are taken out once per function. The result is ordinary readable Python that
numba compiles; it is kept in the repository, and a test derives everything afresh and compares.
"""

import re
import textwrap
from pathlib import Path

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from . import derivation
from .derivation import Derivation

GENERATED = Path(__file__).with_name('generated.py')

_XYZ = 'xyz'
_LINKS = {'1': 'carriage', '2': 'x_rotate', '3': 'y_rotate'}


def _field_of_symbols() -> dict[str, str]:
    """Where each symbol of the derivation is found: its name -> Python expression."""
    fields = {
        'mcw': "p['counterweight_mass']",
        'd2': "p['x_rotate_offset']",
        'a2': "p['y_rotate_offset']",
        'g': "p['gravity']",
        'c1': "p['carriage_cable_mount_height']",
        'c2': "p['counterweight_cable_mount_height']",
        'c3': "p['cable_pulley_height']",
        'cable_length': "p['cable_length']",
        'pulley_radius': "p['cable_pulley_radius']",
        'gear_ratio': "p['gear_ratio']",
        'drive_radius': "p['drive_pulley_radius']",
        'driven_radius': "p['driven_pulley_radius']",
        'J3M': "p['motor_inertia']",
    }
    for number, link in _LINKS.items():
        fields[f'm{number}'] = f"p['{link}_mass']"
        for i, x in enumerate(_XYZ):
            fields[f'r{number}{x}'] = f"p['{link}_centre_of_gravity'][{i}]"
            for j, y in enumerate(_XYZ[i:], start=i):
                fields[f'I{number}{x}{y}'] = f"p['{link}_inertia'][{i}, {j}]"
    for i, x in enumerate(_XYZ):
        fields[f'r4{x}'] = f"p['payload_origin'][{i}]"
    for array, symbols in (
        ('position', derivation.COORDINATES),
        ('velocity', derivation.VELOCITIES),
        ('acceleration', derivation.ACCELERATIONS),
    ):
        for i, symbol in enumerate(symbols):
            fields[symbol.name] = f'{array}[{i}]'
    return fields


def _assignment(target: str, expression: str) -> str:
    """One statement inside a function, broken to the line length of the project."""
    line = f'    {target} = {expression}'
    if len(line) <= 99:
        return line
    body = textwrap.wrap(
        expression,
        width=89,
        initial_indent=' ' * 8,
        subsequent_indent=' ' * 8,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return '\n'.join([f'    {target} = (', *body, '    )'])


def _quoted(docstring: str) -> str:
    return f'"""\n{docstring}\n"""' if '\n' in docstring else f'"""{docstring}"""'


def _natural(symbol: sp.Symbol) -> list:
    """Sort key: as one would list them by hand, theta2 before theta10."""
    return [int(part) if part.isdigit() else part for part in re.split(r'(\d+)', symbol.name)]


def _function(name: str, arguments: str, docstring: str, outputs: dict[str, sp.Expr]) -> str:
    """
    Source of one compiled function.

    ``outputs`` maps each target to its expression. Targets that are plain names are returned, in
    order; others (elements of an array argument) are only assigned.
    """
    expressions = [_nest(expression) for expression in outputs.values()]
    common, reduced = sp.cse(expressions, symbols=sp.numbered_symbols('x'))
    used = sorted(set().union(*(e.free_symbols for e in expressions)), key=_natural)
    fields = _field_of_symbols()
    printer = PythonCodePrinter({'fully_qualified_modules': False})

    lines = [
        '@compiled',
        f'def {name}({arguments}):',
        textwrap.indent(_quoted(docstring), '    '),
        '    p = parameters[0]',
    ]
    lines += [_assignment(symbol.name, fields[symbol.name]) for symbol in used]
    lines += [_assignment(symbol.name, printer.doprint(value)) for symbol, value in common]
    lines += [
        _assignment(t, printer.doprint(value)) for t, value in zip(outputs, reduced, strict=True)
    ]
    returned = [target for target in outputs if target.isidentifier()]
    if returned:
        lines.append(f'    return {", ".join(returned)}')
    return '\n'.join(lines)


def _nest(expression: sp.Expr) -> sp.Expr:
    """Bring to normal form, nested in sines and cosines to save multiplications."""
    expression = derivation.reduce_squares(expression)
    angles = (derivation.theta3, derivation.theta2)
    present = [f(angle) for angle in angles for f in (sp.cos, sp.sin) if expression.has(f(angle))]
    return sp.horner(expression, wrt=present) if present else expression


def source(derived: Derivation) -> str:
    """Source text of ``generated.py``."""
    upper_triangle = {
        f'm_{i + 1}{j + 1}': derived.mass_matrix[i, j] for i in range(3) for j in range(i, 3)
    }
    bias = {f'h_{i + 1}': derived.bias[i] for i in range(3)}
    frame: dict[str, sp.Expr] = {}
    for field, vector in (
        ('position', derived.origin),
        ('velocity', derived.velocity),
        ('angular_velocity', derived.angular_velocity),
        ('acceleration', derived.acceleration),
        ('angular_acceleration', derived.angular_acceleration),
    ):
        frame |= {f"f['{field}'][{i}]": vector[i] for i in range(3)}
    frame |= {
        f"f['rotation'][{i}, {j}]": derived.rotation[i, j] for i in range(3) for j in range(3)
    }

    functions = [
        _function(
            'mass_matrix_and_bias',
            'position, velocity, parameters',
            'Upper triangle of M and vector h of M q_ddot + h = Q (2.26), row by row.\n\n'
            'position (3,): m, rad, rad; velocity (3,): m/s, rad/s, rad/s; parameters (1,) of\n'
            'PARAMETERS. Neither M nor h depends on position[0].',
            upper_triangle | bias,
        ),
        _function(
            'kinetic_and_potential_energy',
            'position, velocity, parameters',
            'T_tot (2.21, 2.22) and V_tot (2.23, 2.24) in J; V_tot counts from the base.',
            {'kinetic': derived.kinetic_energy, 'potential': derived.potential_energy},
        ),
        _function(
            'payload_kinematics',
            'position, velocity, acceleration, parameters, frame',
            'Write the motion of frame 4 in base axes into frame, (1,) of PAYLOAD_FRAME.',
            frame,
        ).replace('    p = parameters[0]', '    p = parameters[0]\n    f = frame[0]'),
    ]
    header = (
        '# SPDX-License-Identifier: Apache-2.0\n'
        f'# Written by generate.py with sympy {sp.__version__}; do not edit.\n'
        '# fmt: off\n'
        '"""The equations of motion as plain code, from the symbolic derivation."""\n\n'
        'from numpy import cos, pi, sin\n\n'
        'from waferbot_lockstep.compiled import compiled\n'
    )
    body = '\n\n\n'.join(functions)
    return f'{header}\n\n{body}\n'


def main() -> None:
    """Derive and write ``generated.py`` beside this file."""
    GENERATED.write_text(source(derivation.derive()), encoding='utf-8')
    print(f'written: {GENERATED}')


if __name__ == '__main__':
    main()
