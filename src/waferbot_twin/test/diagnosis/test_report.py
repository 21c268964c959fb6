# SPDX-License-Identifier: Apache-2.0
"""The page of a diagnosis: what is on it, in which order, and that no text of a user becomes markup."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.print_diagnosis import print_diagnosis
from waferbot_twin.diagnosis import figures, forces, report
from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.diagnosis.diagnose import Alternative, Diagnosis, FoundCause
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.unexplained import Unexplained
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.envelope import MOST_SAMPLES, STRETCHES, envelope
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.library.from_report import read_entries
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.suggestion.rivals import of_report, read_report
from waferbot_twin.validation.gain import gains
from waferbot_twin.validation.gain_report import change_text, draw_gains

EVIL = '<script>alert("l")</script>'
FRICTION_NM = 1.5


@pytest.fixture(scope='module')
def diagnosis():
    """Return a diagnosis as it should come of a log with Coulomb friction on X-Rotate."""
    nominal = Variant.of(load_model('rigid'))
    effect = find('coulomb_friction')
    cause = Cause(effect, 'x_rotate', {'friction': FRICTION_NM})
    extended = apply_all(nominal, [cause])
    timing = Timing()
    twin = Twin.of(extended.model(), timing, load_experiment('wafer_exchange'))
    record = record_of_signals(EVIL, twin.advance(timing.ticks(1.5)))
    problem = Problem(nominal, [record])
    before, after = evaluate(problem), evaluate(problem, (cause,))
    other = Cause(find('viscous_friction'), 'x_rotate', {'damping': 0.3})
    parameters = effect.parameters(nominal, 'x_rotate')
    members = Alternative(cause, 0.9), Alternative(other, 0.08)
    found = FoundCause(cause, parameters, {'friction': (1.4, 1.6)}, 0.98, 0.9, members, 50.0, 0.75)
    maybe = Cause(
        find('stribeck_friction'),
        'y_linear',
        find('stribeck_friction').typical(nominal, 'y_linear'),
    )
    possible = FoundCause(
        maybe,
        maybe.effect.parameters(nominal, 'y_linear'),
        {},
        0.7,
        0.66,
        (Alternative(maybe, 0.66),),
        2.0,
        0.01,
    )
    return Diagnosis(
        nominal,
        extended,
        'partly',
        [found],
        [possible],
        [],
        [Unexplained('y_linear', 'plant', 0.2, 'its speed')],
        gains(nominal, extended, [record]),
        {},
        [EVIL],
        [EVIL],
        Settings(),
        before,
        after,
        {},
        problem,
        164,
        12.0,
        [f'a note on {EVIL}'],
        [
            Correction(
                'mass of the carriage', 'bodies.carriage.mass_kg', 'kg', 40.0, 41.0, 40.5, 41.5
            )
        ],
    )


class Text(HTMLParser):
    """The tags and the text of a page."""

    def __init__(self):
        super().__init__()
        self.tags, self.text = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope='module')
def page(diagnosis):
    return report.page(diagnosis)


@pytest.fixture(scope='module')
def parsed(page):
    parser = Text()
    parser.feed(page)
    return parser


def test_names_of_logs_are_text_and_no_markup(page, parsed):
    assert 'script' not in parsed.tags
    assert EVIL not in page
    assert EVIL in ''.join(parsed.text)


def test_it_needs_no_other_file(page, parsed):
    assert 'http' not in page
    assert 'link' not in parsed.tags
    assert page.count('src="data:image/png;base64,') == parsed.tags.count('img') == 3


def test_what_was_found_comes_before_what_is_left_and_the_pictures(parsed):
    text = ' '.join(parsed.text)
    order = [
        'Coulomb friction on X-Rotate (1.5 Nm,',
        'Causes',
        '1.4 to 1.6 Nm',
        'viscous friction, 300 mNm s/rad on X-Rotate',
        'Possible, but not named',
        'Stribeck friction',
        'Small corrections',
        '40.5 to 41.5 kg',
        'What stays unexplained',
        'its speed',
        'Residual force over speed and position',
        'Error before and after',
        'What each part of the loop leaves over',
        'Withdrawn, and notes',
        'A note on',
    ]
    places = [text.find(words) for words in order]
    assert -1 not in places, dict(zip(order, places, strict=True))
    assert places == sorted(places)


def test_readings_of_a_probability_are_defined_on_the_page(diagnosis, parsed):
    said = 'beyond doubt from 0.95 on, likely from 0.8 on, perhaps below.'
    assert said in ' '.join(' '.join(parsed.text).split()).replace(' ,', ',').replace(' .', '.')
    only_possible = replace(diagnosis, causes=[])
    assert 'from 0.95 on' in report.page(only_possible)


def test_the_bar_is_as_long_as_the_share(page):
    assert page.count('width: 75.0%') == 1


def test_names_of_the_code_are_not_on_the_page(parsed):
    text = ' '.join(parsed.text).replace('bodies.carriage', '')
    for name in ('y_linear', 'x_rotate', 'coulomb_friction', ':x_', '_kg'):
        assert name not in text


def test_the_console_says_what_the_page_says(diagnosis, capsys):
    print_diagnosis(diagnosis)
    text = ' '.join(capsys.readouterr().out.split())
    order = [
        'Coulomb friction on X-Rotate (1.5 Nm,',
        'likely, 0.90',
        '1.4 to 1.6 Nm',
        'may be instead: viscous friction, 300 mNm s/rad on X-Rotate (0.08)',
        'possible, not named',
        'small correction',
        '40.5 to 41.5 kg',
        'unexplained share of the error band',
        'its speed',
        'improvement',
        'a note on',
    ]
    places = [text.find(words) for words in order]
    assert -1 not in places, dict(zip(order, places, strict=True))
    assert places == sorted(places)
    assert 'y_linear' not in text


def test_axes_are_called_what_the_machine_calls_them(diagnosis, capsys, tmp_path):
    titles = {'y_linear': 'Lift', 'x_rotate': 'Arm <b>', 'y_rotate': 'Wrist'}
    own = Overlay({'titles': titles})
    titled = replace(
        diagnosis,
        nominal=diagnosis.nominal.with_overlay(own),
        extended=diagnosis.extended.with_overlay(own),
        notes=['x_rotate.force is not known'],
    )
    report.write(titled, tmp_path)
    page = Text()
    page.feed((tmp_path / 'report.html').read_text('utf-8'))
    assert 'b' not in page.tags
    print_diagnosis(titled)
    for text in (' '.join(page.text), capsys.readouterr().out):
        assert 'Coulomb friction on Arm <b> (1.5 Nm,' in text
        assert 'something on Lift stays unexplained' in text
        assert 'Arm <b> force is not known' in text
        assert not any(title in text for title in USUAL_TITLES.values())
    drawn = [
        panel.get_title(loc)
        for figure in (
            forces.draw_forces(titled),
            figures.draw_residuals(titled),
            draw_gains(titled.gains, titled.nominal.titles),
        )
        for panel in figure.axes
        for loc in ('left', 'center')
    ]
    assert any(title.startswith('Arm <b>') for title in drawn)
    assert not any(usual in title for title in drawn for usual in USUAL_TITLES.values())
    content = json.loads((tmp_path / 'report.json').read_text('utf-8'))
    assert content['causes'][0]['axis'] == 'x_rotate'
    assert content['causes'][0]['title'] == 'Coulomb friction on Arm <b>'
    assert load_model(str(tmp_path / 'extended.yaml')).titles == titles


def test_on_a_narrow_console_nothing_is_cut(diagnosis, capsys, monkeypatch):
    words = {}
    for width in (80, 1000):
        console = Console(width=width, highlight=False, markup=False)
        monkeypatch.setattr('waferbot_twin.cli.print_diagnosis.result_console', console)
        print_diagnosis(diagnosis)
        words[width] = sorted(capsys.readouterr().out.split())
    assert words[80] == words[1000]


def test_nothing_is_said_in_the_controllers_own_units(parsed):
    text = ' '.join(parsed.text)
    assert 'servo cycle' not in text
    assert 'counts' not in text


def test_residual_force_over_speed_is_the_friction(diagnosis):
    speed, _ = forces.residual_forces(diagnosis.problem, diagnosis.before, 'x_rotate')
    fast = np.abs(speed.centre) > 0.3 * np.abs(speed.centre).max()
    # 8 %: the inertia is that at home, and the observer needs some ms after each reversal.
    np.testing.assert_allclose(
        speed.mean[fast],
        -FRICTION_NM * np.sign(speed.centre[fast]),
        rtol=0.0,
        atol=0.08 * FRICTION_NM,
    )
    after, _ = forces.residual_forces(diagnosis.problem, diagnosis.after, 'x_rotate')
    assert np.abs(after.mean).max() < 0.05 * FRICTION_NM


def test_json_has_what_the_page_says(diagnosis, tmp_path):
    report.write(diagnosis, tmp_path)
    content = json.loads((tmp_path / 'report.json').read_text('utf-8'))
    assert content['schema'] == 3
    cause = content['causes'][0]
    assert cause['parameters']['friction'] == {
        'value': FRICTION_NM, 'unit': 'Nm', 'low95': 1.4, 'high95': 1.6,
        'told': True, 'on_bound': False,
    }  # fmt: skip
    assert cause['reading'] == 'likely'
    assert [item['probability'] for item in cause['credible_set']] == [0.9, 0.08]
    assert content['corrections'][0]['found'] == 41.0
    assert load_model(str(tmp_path / 'extended.yaml')).name == 'extended'
    first = (tmp_path / 'extended.yaml').read_text('utf-8').split('\n', 1)[0]
    assert first.startswith(
        '# The model rigid, extended by a diagnosis: Coulomb friction, 1.5 Nm, '
    )


def test_programs_of_our_own_read_the_report(diagnosis, tmp_path):
    report.write(diagnosis, tmp_path)
    group = of_report(read_report(tmp_path), diagnosis.nominal, None)
    assert [item.name for item in group.rivals] == [
        'coulomb_friction:x_rotate',
        'viscous_friction:x_rotate',
    ]
    entries = read_entries(tmp_path, 'mine', '2026-11-30', {})
    assert 'coulomb_friction.friction' in [entry.parameter for entry in entries]


def test_an_envelope_loses_no_peak():
    values = np.zeros(10 * MOST_SAMPLES)
    values[[0, 12345, len(values) - 1]] = 3.0, -2.0, 5.0
    time_s, least, greatest = envelope(np.arange(len(values)) / 1000.0, values)
    assert len(time_s) == len(least) == len(greatest) == STRETCHES
    assert greatest[0] == 3.0
    assert greatest[-1] == 5.0
    assert least.min() == -2.0
    assert time_s[np.argmin(least)] == pytest.approx(12.345, abs=0.03)


@pytest.mark.parametrize(
    ('percent', 'said'),
    [(99.88, 'over 99 %'), (100.0, '100 %'), (62.4, '62 %'), (-710.0, '710 %')],
)
def test_an_error_of_which_some_is_left_is_not_all_gone(percent, said):
    assert change_text(percent) == said
