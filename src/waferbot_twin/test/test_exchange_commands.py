# SPDX-License-Identifier: Apache-2.0
"""`export-model` and `import-urdf`: files that are read again, errors in one line."""

from __future__ import annotations

import json

import mujoco
import pytest

from waferbot_twin.cli.main import main


def test_a_model_goes_out_and_a_robot_comes_in(tmp_path, capsys):
    out = tmp_path / 'new' / 'machine.xml'
    assert main(['export-model', '--model', 'as_built', '--out', str(out), '--json']) == 0
    told = json.loads(capsys.readouterr().out)['axes']
    model = mujoco.MjModel.from_xml_path(str(out))
    dof = model.joint('y_rotate').dofadr[0]
    assert model.dof_frictionloss[dof] == pytest.approx(told['y_rotate']['friction'])
    robot, machine = tmp_path / 'arm.urdf', tmp_path / 'arm.yaml'
    assert main(['export-model', '--model', 'planar_two_link_arm', '--out', str(robot)]) == 0
    assert main(['import-urdf', str(robot), '--out', str(machine)]) == 0
    assert 'lacks motors' in capsys.readouterr().err
    assert machine.read_text().startswith('# From arm.urdf. It lacks:')
    assert main(['modes', '--description', str(machine)]) == 0


def test_a_model_that_was_extended_has_its_friction_there(tmp_path, capsys):
    """10 N more Coulomb friction, as a diagnosis writes it, are 10 N more in the file."""
    from waferbot_twin.effects.coulomb_friction import EFFECT
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model

    variant = Variant.of(load_model('as_built'))
    (name,) = [one.name for one in EFFECT.parameters(variant, 'y_linear')]
    extended = variant.with_overlay(EFFECT.overlay(variant, 'y_linear', {name: 10.0}))
    file = tmp_path / 'extended.yaml'
    file.write_text(extended.text, 'utf-8')
    found = []
    for model in ('as_built', str(file)):
        out = tmp_path / f'{len(found)}.urdf'
        assert main(['export-model', '--model', model, '--out', str(out), '--json']) == 0
        found.append(json.loads(capsys.readouterr().out)['axes']['y_linear'])
    assert found[1]['friction'] - found[0]['friction'] == pytest.approx(10.0, rel=1e-6)
    assert found[1]['damping'] == pytest.approx(found[0]['damping'], rel=1e-6)


def test_what_is_wrong_is_said_in_one_line(tmp_path, capsys):
    there = tmp_path / 'there.urdf'
    there.write_text('<robot/>', 'utf-8')
    for arguments, said in (
        (['export-model', '--out', str(tmp_path / 'machine.sdf')], '.urdf'),
        (['export-model', '--out', str(there)], '--force'),
        (['import-urdf', str(there), '--out', str(tmp_path / 'x.yaml')], 'links are no child'),
        (['import-urdf', str(tmp_path / 'no.urdf'), '--out', str(tmp_path / 'x.yaml')], 'no.urdf'),
    ):
        assert main(arguments) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count('\n') == 1
    assert not (tmp_path / 'x.yaml').exists()
