# SPDX-License-Identifier: Apache-2.0
"""
Tuning: gains for a bandwidth or for an experiment, with margins; feedforward by inverse dynamics.

`loop` linearises a machine at a pose and opens the loop of one axis, `margins` reads gain, phase and
delay margins from it, `gains` turns natural frequency, damping and integral rate into I-variables,
`search` finds them, `feedforward` computes what current a motion needs, `tune` does all of it, and
`report` writes it down.
"""
