# SPDX-License-Identifier: Apache-2.0
"""Errors that are the user's to mend, apart from those that are ours."""


class UserError(Exception):
    """
    Something that the user can put right: a wrong file, key, value, topic or tick.

    The message is complete by itself: what was wrong, where (file, line, key, topic, tick) and what
    to do. Commands and nodes print it as one line and end with a non-zero exit code; any other
    exception is a defect of waferbot and keeps its traceback.
    """


class LockstepError(UserError):
    """
    The lock-step between the nodes broke: a peer is missing, or sent what it may not send.

    Names the peer, the topic and the tick. Nothing is simulated past that tick.
    """
