# SPDX-License-Identifier: Apache-2.0
"""
FMI: parts of the twin as FMUs, and a foreign FMU as the plant.

`blocks` are plant, PMAC, Copley and the whole twin with named inputs and outputs, `export` writes one
as an FMU, `slave` is what runs inside it, `lockstep` runs an FMU in the place of the plant in process
(over ROS: `waferbot_plant.mechanisms`).
"""
