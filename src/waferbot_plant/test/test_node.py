# SPDX-License-Identifier: Apache-2.0
"""The plant node by itself: how it begins, and that it does not go on with what blew up."""

from __future__ import annotations

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')
pytest.importorskip('waferbot_msgs')


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch):
    """Return a plant node of the rigid machine, alone on its machine."""
    from waferbot_plant.node import PlantNode

    monkeypatch.setenv('ROS_DOMAIN_ID', '87')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    plant_node = PlantNode()
    try:
        yield plant_node
    finally:
        plant_node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.slow
def test_node_begins_where_the_motors_hold_the_weight(node) -> None:
    expected = node._mechanism._machine.resting_state(node._mechanism.parameters)
    assert node._mechanism.state.tobytes() == expected.tobytes()
    assert abs(node._mechanism.state[0]['winding_current'][1]).max() > 1.0
    node.begin()
    assert node.outcome is None


@pytest.mark.slow
def test_node_stops_with_axis_and_tick_when_the_plant_blew_up(node) -> None:
    node._mechanism.state[0]['velocity'][1] = np.nan
    node.begin()
    assert 'blew up by tick 0' in node.outcome
    assert 'axis x_rotate' in node.outcome


@pytest.mark.slow
def test_diagnostics_warn_of_a_belt_that_is_slack(monkeypatch: pytest.MonkeyPatch) -> None:
    from diagnostic_msgs.msg import DiagnosticStatus

    from waferbot_plant.node import PlantNode

    monkeypatch.setenv('ROS_DOMAIN_ID', '87')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    overrides = [rclpy.parameter.Parameter('description', value='flexible')]
    plant_node = PlantNode(parameter_overrides=overrides)
    try:
        plant_node.begin()
        assert plant_node.diagnostics()[1] == []
        machine, state = plant_node._mechanism._machine, plant_node._mechanism.state
        row, ratio = machine.assembly.placing['y_rotate']
        state[0]['position'][row] += 0.2 / ratio  # the motor stands: 0.2 rad is far beyond 2 F_pre
        plant_node._publish_slow_topics(180)
        ((level, text), *_) = plant_node.diagnostics()[1]
        assert level == DiagnosticStatus.WARN
        assert text.startswith('belt: tension of the slack span -')
        assert 'at 0.010 s' in text
    finally:
        plant_node.destroy_node()
        rclpy.try_shutdown()
