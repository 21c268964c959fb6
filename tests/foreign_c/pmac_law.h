/* SPDX-License-Identifier: Apache-2.0
 *
 * The servo law of a stranger's Turbo PMAC (User Manual, "Actual PID Algorithm"), in what C and C++ share.
 *
 * Its sums are of whole numbers, so that float64 carries them exactly, in whatever order; compile without
 * fused multiply-add (-ffp-contract=off).
 */

#ifndef FOREIGN_C_PMAC_LAW_H
#define FOREIGN_C_PMAC_LAW_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { MOTORS = 3, GIVEN = 9, SERVO_TICKS = 8 };

#define INTEGRATOR_UNITS 8388608.0          /* 2^23 */
#define INTEGRATOR_LIMIT 4194304.0          /* Ixx63, 1/16 count */
#define OUTPUT_LIMIT 32767.0                /* Ixx69, DAC bits */

/* Places in `counts` of each motor's encoder for position (Ixx03) and velocity (Ixx04): the last has two. */
static const int POSITION[MOTORS] = {0, 1, 2};
static const int VELOCITY[MOTORS] = {0, 1, 3};

typedef struct {
  double step, ixx08, ixx09, ixx29, ixx30, ixx31, ixx32, ixx33, peak_current; /* as given */
  double start;                                                               /* counts */
  double command, velocity_feedback, integrator; /* of the cycle before, in the law's registers */
} Motor;

/* Read the nine numbers of a motor. */
static Motor read_motor(char **own) {
  Motor m;
  memset(&m, 0, sizeof m);
  m.step = atof(own[0]);
  m.ixx08 = atof(own[1]);
  m.ixx09 = atof(own[2]);
  m.ixx29 = atof(own[3]);
  m.ixx30 = atof(own[4]);
  m.ixx31 = atof(own[5]);
  m.ixx32 = atof(own[6]);
  m.ixx33 = atof(own[7]);
  m.peak_current = atof(own[8]);
  return m;
}

/* Close the loop of a motor where it stands: no velocity, no integral. */
static void prime(Motor *m, const int64_t *counts, int i) {
  m->start = (double)counts[POSITION[i]];
  m->command = floor(m->start * 32.0 * m->ixx08 + 0.5);
  m->velocity_feedback = (double)counts[VELOCITY[i]] * 32.0 * m->ixx09;
  m->integrator = 0.0;
}

/* Run the servo, `cycles` after it was last run; return the current, A. */
static double close_loop(Motor *m, const int64_t *counts, int i, bool stepped, double cycles) {
  const double scale = 32.0 * m->ixx08;
  const double limit = INTEGRATOR_LIMIT * 2.0 * m->ixx08 * INTEGRATOR_UNITS;
  const double command = floor((m->start + (stepped ? m->step : 0.0)) * scale + 0.5);
  const double command_velocity = (command - m->command) / cycles;
  const double feedback = (double)counts[VELOCITY[i]] * 32.0 * m->ixx09;
  const double velocity = (feedback - m->velocity_feedback) / cycles;
  const double error = command - (double)counts[POSITION[i]] * scale;
  const double damping = (m->ixx32 * command_velocity - m->ixx31 * velocity) / 128.0;
  const double total = error + damping + m->integrator / INTEGRATOR_UNITS;
  double output = m->ixx30 / 16777216.0 * total + m->ixx29;
  m->command = command;
  m->velocity_feedback = feedback;
  if (fabs(output) >= OUTPUT_LIMIT) {
    output = copysign(OUTPUT_LIMIT, output); /* and the integrator is held */
  } else if (command_velocity == 0.0) {      /* Ixx34 is 1: no integration during a commanded move */
    m->integrator = fmax(-limit, fmin(limit, m->integrator + m->ixx33 * error * cycles));
  }
  return floor(output * 256.0) / 256.0 * m->peak_current / 32768.0;
}

#endif
