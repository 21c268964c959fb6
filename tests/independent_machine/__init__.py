# SPDX-License-Identifier: Apache-2.0
"""
A second simulator: one-axis machines with hidden effects, and their logs as a user has them.

It shares no code with waferbot, so that a diagnosis of its logs is no test of a model against itself:
other equations of friction and contact, another integrator, another controller, another clock.

    from independent_machine.cases import draw
    from independent_machine.files import write_case
    case = draw(seed=1, number=3)
    case.hidden                   # what the description does not say, with sizes
    write_case(case, folder)      # estimation.csv, validation.csv, machine.yaml, map.yaml
"""
