# SPDX-License-Identifier: Apache-2.0
"""The notebooks of the documentation run from first cell to last, and what they claim is so."""

from __future__ import annotations

from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[3] / 'docs' / 'notebooks'
LEAVES = {
    'run': ['runs/step/metadata.yaml'],
    'diagnose': ['report/report.html', 'report/extended.yaml'],
    'identify': ['report/report.html', 'identified.yaml'],
    'own_machine': ['measured/metadata.yaml', 'slide.yaml'],
}
"""By name: what is there after it."""

pytestmark = [pytest.mark.slow, pytest.mark.long(200), pytest.mark.timeout(3600)]


def test_all_of_them_are_run_here():
    assert {file.stem for file in NOTEBOOKS.glob('*.ipynb')} == set(LEAVES)


@pytest.mark.parametrize('name', LEAVES)
def test_the_notebook_runs(name, tmp_path):
    nbformat, nbclient = pytest.importorskip('nbformat'), pytest.importorskip('nbclient')
    notebook = nbformat.read(NOTEBOOKS / f'{name}.ipynb', as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == 'code']
    assert not any(cell.outputs for cell in cells), 'outputs are not kept in the repository'
    assert any(line.startswith('assert ') for cell in cells for line in cell.source.split('\n'))
    place = {'metadata': {'path': str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=3000, resources=place).execute()
    assert all((tmp_path / file).exists() for file in LEAVES[name])
