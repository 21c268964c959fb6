# SPDX-License-Identifier: Apache-2.0
"""The contract between the nodes, in code: time, topics, wire format, order of messages, parameters."""
