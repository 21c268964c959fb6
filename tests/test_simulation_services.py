# SPDX-License-Identifier: Apache-2.0
"""Time goes on by steps, stands, and begins anew, as somebody asks for it."""

from __future__ import annotations

import importlib.util
import time

import numpy as np
import pytest
from harness import run_engine, start_node
from rclpy.qos import QoSProfile

import waferbot_msgs.msg
from waferbot_lockstep.contract import PHASE_CURRENTS
from waferbot_lockstep.transport import (
    BUILTIN_TRANSPORTS,
    DISCOVERY,
    PROFILES,
    choose_transport,
)

NODES = ('plant', 'pmac', 'copley')
INSTALLED = importlib.util.find_spec('simulation_interfaces') is not None

pytestmark = pytest.mark.slow
needs_the_package = pytest.mark.skipif(
    not INSTALLED, reason='the package simulation_interfaces is not installed'
)


# ---- what the plant does, in one process, without the services -------------------------------------


class Twin:
    """The three nodes in one process."""

    def __init__(self, timekeeping):
        import rclpy

        from waferbot_copley.node import CopleyNode
        from waferbot_lockstep.node import make_executor
        from waferbot_plant.node import PlantNode
        from waferbot_pmac.node import PmacNode
        from waferbot_twin.engines.members import ros_parameters
        from waferbot_twin.models import load_model

        choose_transport()
        rclpy.init()
        parameters = load_model('rigid').parameters
        common = {'timekeeping': timekeeping}
        own = {'plant': {'start_paused': True, 'realtime_factor': 0.02}, 'pmac': {}, 'copley': {}}
        if timekeeping == 'lockstep':
            del own['plant']['realtime_factor']
        self.plant, *_ = self.nodes = [
            kind(
                parameter_overrides=list(
                    ros_parameters({**parameters[name], **common, **own[name]})
                )
            )
            for name, kind in (('plant', PlantNode), ('pmac', PmacNode), ('copley', CopleyNode))
        ]
        self.executor = make_executor()
        for node in self.nodes:
            self.executor.add_node(node)
            node.begin()

    def spin_until(self, done, what, timeout_s=60.0):
        deadline_s = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < deadline_s, f'{what} at {self.plant.tick}'
            due_s = self.plant.sleep_time_s()
            self.executor.spin_once(timeout_sec=0.05 if due_s is None else max(due_s, 0.0))
            if due_s is not None:
                self.plant.on_time()
            assert all(node.outcome is None for node in self.nodes)

    def stands(self, tick):
        """Check that time stands at a tick for a while."""
        end_s = time.monotonic() + 0.5
        self.spin_until(lambda: time.monotonic() > end_s, 'standing')
        assert self.plant.tick == tick

    def step(self, ticks):
        answers = []
        self.plant.step(ticks, answers.append)
        self.spin_until(lambda: answers, f'{ticks} steps')
        return answers[0]

    def end(self):
        import rclpy

        for node in self.nodes:
            self.executor.remove_node(node)
        self.executor.shutdown(0.0)
        for node in self.nodes:
            node.interrupt()
            node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def twin(request, domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    for name in (DISCOVERY, PROFILES, BUILTIN_TRANSPORTS):  # as they are found here, and no other
        monkeypatch.setenv(name, '')
        monkeypatch.delenv(name)
    made = Twin(request.param)
    yield made
    made.end()


@pytest.mark.parametrize('twin', ['lockstep', 'realtime'], indirect=True)
def test_steps_are_taken_while_time_is_paused_and_not_one_more(twin):
    assert twin.step(1) == ''
    twin.stands(1)
    assert twin.step(120) == ''
    assert twin.plant.tick == 121
    assert twin.step(0) == ''
    twin.stands(121)
    one, other = [], []
    twin.plant.step(1000, one.append)
    twin.plant.step(5, other.append)
    assert other == ['the steps asked for before are still to be taken']
    twin.plant.pause(True)
    assert one == ['paused by somebody else']
    at = twin.plant.tick
    twin.stands(at)
    twin.plant.pause(False)
    twin.spin_until(lambda: twin.plant.tick > at + 100, 'time going on')
    twin.plant.step(5, other.append)
    assert other[1:] == ['time is not paused']


@pytest.mark.parametrize('twin', ['lockstep'], indirect=True)
def test_in_lockstep_there_is_no_way_back(twin):
    assert twin.step(20) == ''
    assert twin.plant.reset() == 'in lock-step no tick is given twice: start all nodes again'
    twin.stands(20)


@pytest.mark.alone
@pytest.mark.parametrize('twin', ['realtime'], indirect=True)
def test_in_real_time_all_begin_anew_with_the_plant(twin):
    plant, pmac, copley = twin.nodes
    beginning = plant._mechanism.state.tobytes()
    assert twin.step(300) == ''
    assert plant._mechanism.state.tobytes() != beginning
    assert plant.reset() == ''
    assert plant._mechanism.state.tobytes() == beginning
    # They see it when tick 0 comes again and again; how soon, no clock says.
    twin.spin_until(lambda: (pmac.tick, copley.tick) == (8, 1), 'beginning anew with the plant')
    twin.stands(0)
    assert (pmac.tick, copley.tick) == (8, 1), 'they have answered tick 0'
    assert twin.step(400) == ''
    assert plant.tick == 400
    twin.spin_until(lambda: min(pmac.tick, copley.tick) > 380, 'following the plant')
    assert plant.inboxes[next(iter(plant.inboxes))].arrivals.contradicting == 0


# ---- the services of simulation_interfaces ---------------------------------------------------------


class Tool:
    """Somebody who knows simulators in general: calls the services."""

    def __init__(self, client):
        import simulation_interfaces.msg
        import simulation_interfaces.srv

        self.client = client
        self.services = simulation_interfaces.srv
        self.results = simulation_interfaces.msg.Result
        self.states = simulation_interfaces.msg.SimulationState

    def call(self, kind, name, **fields):
        service = getattr(self.services, kind)
        return self.client.call(service, f'plant/{name}', service.Request(**fields))

    def features(self):
        told = self.call('GetSimulatorFeatures', 'get_simulator_features').features
        known = type(told)
        names = {
            getattr(known, name): name
            for name in dir(known)
            if name.startswith(('SIMULATION', 'STEP'))
        }
        return {names[number] for number in told.features}, told.custom_info

    def state(self):
        answer = self.call('GetSimulationState', 'get_simulation_state')
        assert answer.result.result == self.results.RESULT_OK
        return answer.state.state

    def set_state(self, state):
        return self.call(
            'SetSimulationState', 'set_simulation_state', state=self.states(state=state)
        ).result

    def step(self, steps):
        return self.call('StepSimulation', 'step_simulation', steps=steps).result

    def reset(self, scope):
        return self.call('ResetSimulation', 'reset_simulation', scope=scope).result


@needs_the_package
def test_a_twin_in_lockstep_is_stepped_to_the_same_bits(start, domain, connect, tmp_path):
    nodes = [
        start_node(start, name, domain, *(('start_paused:=true',) if name == 'plant' else ()))
        for name in NODES
    ]
    client = connect(domain)
    heard = {}
    client.node.create_subscription(
        waferbot_msgs.msg.PhaseCurrents,
        'phase_currents',
        lambda message: heard.update({message.tick: list(message.current)}),
        QoSProfile(depth=1024),
    )
    tool = Tool(client)
    assert tool.features() == (
        {
            'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE',
            'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE',
        },
        'a step is one tick of the current loop, 5.55556e-05 s; no reset in lock-step, as no tick '
        'is given twice',
    )  # fmt: skip
    assert tool.state() == tool.states.STATE_STOPPED
    client.spin_until(lambda: 0 in heard, 'tick 0')
    for steps, ticks in ((1, 1), (2, 3), (7, 10), (8, 18), (200, 218), (0, 218), (82, 300)):
        assert tool.step(steps).result == tool.results.RESULT_OK
        client.spin_until(lambda ticks=ticks: max(heard) >= ticks, f'tick {ticks}')
        assert tool.state() == tool.states.STATE_PAUSED
        assert max(heard) == ticks
    truth = run_engine('inprocess', tmp_path / 'truth', 'constant', duration_s=301 / 18000)
    np.testing.assert_array_equal(
        np.array([heard[tick] for tick in range(301)]).ravel(),
        np.asarray(truth[PHASE_CURRENTS]['current']).ravel(),
    )
    for refused in (tool.reset(0), tool.set_state(tool.states.STATE_STOPPED)):
        assert refused.result == tool.results.RESULT_FEATURE_UNSUPPORTED
        assert 'no tick is given twice' in refused.error_message
    again = tool.services.SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert tool.set_state(tool.states.STATE_PAUSED).result == again
    assert tool.set_state(tool.states.STATE_PLAYING).result == tool.results.RESULT_OK
    assert tool.state() == tool.states.STATE_PLAYING
    client.spin_until(lambda: max(heard) > 600, 'time going on')
    refused = tool.step(1)
    assert refused.result == tool.results.RESULT_OPERATION_FAILED
    assert refused.error_message == 'time is not paused'
    assert tool.set_state(250).result == tool.results.RESULT_FEATURE_UNSUPPORTED
    tool.set_state(tool.states.STATE_QUITTING)
    for node in nodes:
        assert node.wait() == 0, node.output


@needs_the_package
@pytest.mark.alone
def test_a_twin_in_real_time_is_reset(start, domain, connect):
    for name in NODES:
        start_node(start, name, domain, 'timekeeping:=realtime')
    client = connect(domain)
    ticks = []
    client.node.create_subscription(
        waferbot_msgs.msg.PhaseVoltages,
        'phase_voltages',
        lambda message: ticks.append(message.tick),
        QoSProfile(depth=1024),
    )
    tool = Tool(client)
    assert 'SIMULATION_RESET' in tool.features()[0]
    client.spin_until(lambda: ticks and ticks[-1] > 1500, 'tick 1500')
    assert tool.reset(1).result == tool.results.RESULT_FEATURE_UNSUPPORTED
    assert tool.reset(0).result == tool.results.RESULT_OK
    client.spin_until(lambda: ticks[-1] < 1000, 'the beginning')
    client.spin_until(lambda: ticks[-1] > 1500, 'tick 1500 again')
    assert tool.set_state(tool.states.STATE_STOPPED).result == tool.results.RESULT_OK
    client.spin_until(lambda: ticks[-1] == 0, 'tick 0')
    assert tool.state() == tool.states.STATE_STOPPED
    assert tool.step(10).result == tool.results.RESULT_OK
    assert tool.state() == tool.states.STATE_PAUSED
    client.spin_until(lambda: ticks[-1] >= 9, 'tick 9')
    assert tool.set_state(tool.states.STATE_PLAYING).result == tool.results.RESULT_OK
    client.spin_until(lambda: ticks[-1] > 1500, 'tick 1500 once more')
