# SPDX-License-Identifier: Apache-2.0
"""
Controllers of machines that no PMAC drives: a law that is described, compiled, and closed over the
plant.

`law` is the law alone, `closed_loop` runs it with the plant of a model; descriptions are read by
`waferbot_plant.description_controllers`.
"""
