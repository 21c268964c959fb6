# SPDX-License-Identifier: Apache-2.0
"""
Repeatable noise: random numbers that are a function of (seed, channel, counter).

A generator with a state gives other numbers as soon as anybody draws one more or in another order.
Here there is no state: whoever needs the noise of channel 3 at tick 1000 asks for it, at any time,
over ROS or in process, and gets the same bits. The number is the hash

    h(counter) = mix(key + counter G)        key = mix(mix(seed + G) + channel G)

where `mix` is the finaliser of SplitMix64 (a bijection of 64-bit words in which every bit of the
input turns over every bit of the output with a chance of one half) and G = 2^64 / golden ratio.
For one key this is the sequence of the generator SplitMix64 itself, of period 2^64.

Only integer operations and exact float64 ones are used, no function of the C library; so the same
bits come out on every machine.

`seed` says which realisation, `channel` keeps sources of one run apart (give every source its own
number), `counter` is the tick or sample. All three are int64, of any sign.

Source: G. L. Steele, D. Lea, C. H. Flood, Fast splittable pseudorandom number generators, OOPSLA
2014; the constants of `mix` are D. Stafford's variant 13.
"""

from __future__ import annotations

import numpy as np

from waferbot_lockstep.compiled import compiled

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FACTOR_1 = np.uint64(0xBF58476D1CE4E5B9)
_FACTOR_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)
_PIECE, _PIECE_MASK = np.uint64(16), np.uint64(0xFFFF)
_UNUSED_BITS = np.uint64(11)
_WORDS = np.uint64(3)

_PIECES = 12
_MEAN_OF_PIECES = _PIECES * 65535 // 2
_DEVIATION_OF_PIECES = 65536.0


@compiled
def _mix(word):
    """Return a 64-bit word thoroughly mixed (a bijection)."""
    word = (word ^ (word >> _SHIFT_1)) * _FACTOR_1
    word = (word ^ (word >> _SHIFT_2)) * _FACTOR_2
    return word ^ (word >> _SHIFT_3)


@compiled
def hashed(seed, channel, counter):
    """Return the 64-bit hash (uint64) of three whole numbers."""
    key = _mix(_mix(np.uint64(seed) + _GOLDEN) + np.uint64(channel) * _GOLDEN)
    return _mix(key + np.uint64(counter) * _GOLDEN)


@compiled
def uniform(seed, channel, counter):
    """
    Return a number that is uniform in 0 <= u < 1, a multiple of 2^-53.

    Mean 1/2, variance 1/12.
    """
    return np.float64(np.int64(hashed(seed, channel, counter) >> _UNUSED_BITS)) * 2.0**-53


@compiled
def normal(seed, channel, counter):
    """
    Return a deviate that is close to normal, of mean 0 and standard deviation 1.

    It is the sum of twelve uniform ones of 16 bits each (Irwin-Hall): mean 0 exactly, variance
    1 - 2^-32, excess kurtosis -0.1, never beyond +-6; the density is within 0.01 of the normal one
    everywhere and too small beyond 3.5 standard deviations. The steps are 2^-16. Good for noise
    of sensors and forces, not for the statistics of rare events.
    """
    first = np.uint64(counter) * _WORDS
    total = np.int64(0)
    for place in range(3):
        word = hashed(seed, channel, first + np.uint64(place))
        for _ in range(4):
            total += np.int64(word & _PIECE_MASK)
            word >>= _PIECE
    return np.float64(total - _MEAN_OF_PIECES) / _DEVIATION_OF_PIECES
