# SPDX-License-Identifier: Apache-2.0
"""
The plant as a simulator for tools that know none in particular: services of `simulation_interfaces`.

That is the ROS 2 package of common interfaces to simulators; Gazebo and Isaac Sim serve them, too. They
are served where it is installed (`ros-jazzy-simulation-interfaces`):

    ~/get_simulator_features, ~/get_simulation_state, ~/set_simulation_state,
    ~/step_simulation, ~/reset_simulation

A step is one tick of the current loop. The answer to a step comes when all its ticks are taken. A reset
is that of everything, time and state, and possible in real time only: see `PlantNode.reset`.

    STOPPED   paused at tick 0, never let go; in real time also after a reset that was asked for so
    PAUSED    time stands
    PLAYING   time goes on as the voltages come
    QUITTING  can be set: the twin ends as by an interrupt, in lock-step with all its nodes
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from waferbot_lockstep.late_answers import Future, answer_later
from waferbot_lockstep.node_settings import REALTIME

if TYPE_CHECKING:
    from waferbot_plant.node import PlantNode

STEPPING = 'a step is one tick of the current loop, {tick_s:g} s'


def offer_simulation_services(plant: PlantNode) -> bool:
    """Serve them if their types are installed; return whether they are."""
    try:
        import simulation_interfaces.msg
        import simulation_interfaces.srv
    except ImportError:
        return False
    SimulationServices(plant, simulation_interfaces.msg, simulation_interfaces.srv)
    return True


class SimulationServices:
    """The services; `messages` and `services` are the generated modules of the package."""

    def __init__(self, plant: PlantNode, messages: Any, services: Any) -> None:
        """Begin as STOPPED if the plant has been started paused."""
        self._plant = plant
        self._features = messages.SimulatorFeatures
        self._states = messages.SimulationState
        self._results = messages.Result
        self._set_state = services.SetSimulationState.Response
        self._stopped = plant.paused
        for kind, name, answer in (
            (services.GetSimulatorFeatures, 'get_simulator_features', self._on_features),
            (services.GetSimulationState, 'get_simulation_state', self._on_get_state),
            (services.SetSimulationState, 'set_simulation_state', self._on_set_state),
            (services.ResetSimulation, 'reset_simulation', self._on_reset),
        ):
            plant.create_service(kind, f'~/{name}', answer)
        answer_later(
            plant.create_service(services.StepSimulation, '~/step_simulation', self._on_step)
        )

    def _on_features(self, request: Any, response: Any) -> Any:
        known = self._features
        features = [
            known.SIMULATION_STATE_GETTING,
            known.SIMULATION_STATE_SETTING,
            known.SIMULATION_STATE_PAUSE,
            known.STEP_SIMULATION_SINGLE,
            known.STEP_SIMULATION_MULTIPLE,
        ]
        info = STEPPING.format(tick_s=self._plant.timing.tick_s)
        if self._resettable:
            features += [
                known.SIMULATION_RESET,
                known.SIMULATION_RESET_TIME,
                known.SIMULATION_RESET_STATE,
            ]
            info += '; time and state are reset together'
        else:
            info += '; no reset in lock-step, as no tick is given twice'
        response.features.features = features
        response.features.custom_info = info
        return response

    def _on_get_state(self, request: Any, response: Any) -> Any:
        response.state.state = self._state()
        return self._say(response, self._results.RESULT_OK)

    def _on_set_state(self, request: Any, response: Any) -> Any:
        known, wanted = self._states, request.state.state
        if wanted == self._state():
            return self._say(response, self._set_state.ALREADY_IN_TARGET_STATE)
        if wanted == known.STATE_STOPPED:
            if self._resettable:
                self._plant.pause(True)
            return self._reset(response)
        if wanted == known.STATE_PLAYING:
            self._plant.pause(False)
        elif wanted == known.STATE_PAUSED:
            self._plant.pause(True)
        elif wanted == known.STATE_QUITTING:
            self._plant.interrupt()
        else:
            return self._say(
                response,
                self._results.RESULT_FEATURE_UNSUPPORTED,
                f'no state {wanted}: the twin has one machine, and no worlds to load',
            )
        self._stopped = False
        return self._say(response, self._results.RESULT_OK)

    def _on_step(self, request: Any, response: Any) -> Future:
        answered: Future = Future()
        results = self._results

        def done(failure: str) -> None:
            code = results.RESULT_OPERATION_FAILED if failure else results.RESULT_OK
            answered.set_result(self._say(response, code, failure))

        self._plant.step(request.steps, done)
        return answered

    def _on_reset(self, request: Any, response: Any) -> Any:
        whole = request.SCOPE_TIME | request.SCOPE_STATE
        if request.scope == request.SCOPE_DEFAULT or request.scope & whole == whole:
            return self._reset(response)
        return self._say(
            response,
            self._results.RESULT_FEATURE_UNSUPPORTED,
            'time and state can only be reset together, and nothing is ever spawned',
        )

    def _reset(self, response: Any) -> Any:
        failure = self._plant.reset()
        if failure:
            return self._say(response, self._results.RESULT_FEATURE_UNSUPPORTED, failure)
        self._stopped = self._plant.paused
        return self._say(response, self._results.RESULT_OK)

    @property
    def _resettable(self) -> bool:
        return self._plant.timekeeping == REALTIME

    def _state(self) -> int:
        if not self._plant.paused:
            return int(self._states.STATE_PLAYING)
        stopped = self._stopped and self._plant.tick == 0
        return int(self._states.STATE_STOPPED if stopped else self._states.STATE_PAUSED)

    def _say(self, response: Any, code: int, message: str = '') -> Any:
        response.result.result = code
        response.result.error_message = message
        return response
