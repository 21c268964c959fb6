/* SPDX-License-Identifier: Apache-2.0
 *
 * The current loop of a stranger's amplifiers, in what C and C++ share.
 *
 * docs/contract.md says under "The same bits" what to compute in which order; compile without fused
 * multiply-add (-ffp-contract=off). The current loop is that of the thesis; of a drive's protections it has
 * none but the peak current.
 */

#ifndef FOREIGN_C_COPLEY_LAW_H
#define FOREIGN_C_COPLEY_LAW_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { MOTORS = 3, LINES = 2, GIVEN = 7, ENCODER_TICKS = 2, SERVO_TICKS = 8 };

#define DUTY 32.0

typedef struct {
  double encoder, counts_per_cycle, proportional, integral, bus, peak, resistance; /* as given */
  double sum[LINES]; /* integrators of lines 1 and 2 */
} Amplifier;

/* Read the seven numbers of a motor. */
static Amplifier read_amplifier(char **own) {
  Amplifier a;
  memset(&a, 0, sizeof a);
  a.encoder = atof(own[0]);
  a.counts_per_cycle = atof(own[1]);
  a.proportional = atof(own[2]);
  a.integral = atof(own[3]);
  a.bus = atof(own[4]);
  a.peak = atof(own[5]);
  a.resistance = atof(own[6]);
  return a;
}

/* Sine and cosine of an angle in turns, 0 <= turn < 1: whole quarters, and Taylor's polynomial within
   an eighth. The C library's differ in the last bit from one version to the next. */
static void sine_and_cosine(double turn, double *sine, double *cosine) {
  const double quarters = floor(4.0 * turn + 0.5);
  const double x = 6.283185307179586 * (turn - 0.25 * quarters);
  const double y = x * x;
  double s = 1.0 / 39916800.0 - y * (1.0 / 6227020800.0 - y * (1.0 / 1307674368000.0));
  s = 1.0 / 6.0 - y * (1.0 / 120.0 - y * (1.0 / 5040.0 - y * (1.0 / 362880.0 - y * s)));
  s = x - x * y * s;
  double c = 1.0 / 479001600.0 - y * (1.0 / 87178291200.0 - y * (1.0 / 20922789888000.0));
  c = 1.0 / 24.0 - y * (1.0 / 720.0 - y * (1.0 / 40320.0 - y * (1.0 / 3628800.0 - y * c)));
  c = 1.0 - y * (0.5 - y * c);
  switch ((int)quarters) {
    case 1: *sine = c, *cosine = -s; break;
    case 2: *sine = -s, *cosine = -c; break;
    case 3: *sine = -c, *cosine = s; break;
    default: *sine = s, *cosine = c;
  }
}

static double clamp(double value, double limit) {
  return value > limit ? limit : value < -limit ? -limit : value;
}

/* Run the current loop of a motor, `ticks` after it was last run; fill its three voltages. */
static void close_loop(Amplifier *a, bool first, double ticks, const int64_t *counts, double command,
                       const double *current, double *voltage) {
  double turn = (double)counts[(int)a->encoder] / a->counts_per_cycle;
  turn -= floor(turn);
  double sine, cosine;
  sine_and_cosine(turn < 1.0 ? turn : 0.0, &sine, &cosine);

  double wanted[LINES];
  wanted[0] = command * sine;
  wanted[1] = 0.8660254037844386 * -(command * cosine) - 0.5 * wanted[0];
  const double third = clamp(-(wanted[0] + wanted[1]), a->peak);
  wanted[0] = clamp(wanted[0], a->peak);
  wanted[1] = clamp(wanted[1], a->peak);
  const double common = (wanted[0] + wanted[1] + third) / 3.0;

  const double duty_of_volt = DUTY / a->bus, volts = a->bus / a->peak;
  for (int k = 0; k < LINES; ++k) {
    const double error = wanted[k] - common - current[k];
    if (first) { /* with what keeps up the present current */
      a->sum[k] = a->resistance / (duty_of_volt * volts) * current[k];
    }
    voltage[k] = (a->proportional * error + a->sum[k]) * duty_of_volt * volts;
    a->sum[k] += a->integral * error * ticks;
  }
  voltage[2] = -(voltage[0] + voltage[1]);
}

static bool all_finite(const double *values, int count) {
  for (int i = 0; i < count; ++i) {
    if (!isfinite(values[i])) {
      return false;
    }
  }
  return true;
}

#endif
