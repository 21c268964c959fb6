/* SPDX-License-Identifier: Apache-2.0
 *
 * A stranger's Turbo PMAC in C on rcl: counts in, current commands out.
 *
 * It shares nothing with waferbot but the messages: docs/contract.md says when to speak, and the Turbo
 * PMAC User Manual ("Actual PID Algorithm") what to say. Its sums are of whole numbers, so that float64
 * carries them exactly, in whatever order; compile without fused multiply-add (-ffp-contract=off).
 *
 *   pmac STEP_TICK  COUNTS Ixx08 Ixx09 Ixx29 Ixx30 Ixx31 Ixx32 Ixx33 PEAK_CURRENT  (nine for each motor)
 *
 * At STEP_TICK each motor is commanded to step by COUNTS from where it stood at the beginning.
 */

#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <rcl/rcl.h>
#include <rcl/error_handling.h>

#include "waferbot_msgs/msg/current_command.h"
#include "waferbot_msgs/msg/encoders.h"
#include "waferbot_msgs/msg/stop.h"

enum { MOTORS = 3, SERVO_TICKS = 8, DEPTH = 1024 };

#define REPEAT_AFTER_NS (100 * 1000 * 1000) /* ten times a second, while it waits */
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

static volatile sig_atomic_t asked_to_end = 0;

static void end(int number) {
  (void)number;
  asked_to_end = 1;
}

static int64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void check(rcl_ret_t result, const char *what) {
  if (result != RCL_RET_OK) {
    fprintf(stderr, "pmac: %s: %s\n", what, rcl_get_error_string().str);
    exit(1);
  }
}

/* Close the loop of a motor where it stands: no velocity, no integral. */
static void prime(Motor *m, const int64_t *counts, int i) {
  m->start = (double)counts[POSITION[i]];
  m->command = floor(m->start * 32.0 * m->ixx08 + 0.5);
  m->velocity_feedback = (double)counts[VELOCITY[i]] * 32.0 * m->ixx09;
  m->integrator = 0.0;
}

/* Run one servo cycle; return the current, A. */
static double close_loop(Motor *m, const int64_t *counts, int i, bool stepped) {
  const double scale = 32.0 * m->ixx08;
  const double limit = INTEGRATOR_LIMIT * 2.0 * m->ixx08 * INTEGRATOR_UNITS;
  const double command = floor((m->start + (stepped ? m->step : 0.0)) * scale + 0.5);
  const double command_velocity = command - m->command;
  const double feedback = (double)counts[VELOCITY[i]] * 32.0 * m->ixx09;
  const double velocity = feedback - m->velocity_feedback;
  const double error = command - (double)counts[POSITION[i]] * scale;
  const double damping = (m->ixx32 * command_velocity - m->ixx31 * velocity) / 128.0;
  const double total = error + damping + m->integrator / INTEGRATOR_UNITS;
  double output = m->ixx30 / 16777216.0 * total + m->ixx29;
  m->command = command;
  m->velocity_feedback = feedback;
  if (fabs(output) >= OUTPUT_LIMIT) {
    output = copysign(OUTPUT_LIMIT, output); /* and the integrator is held */
  } else if (command_velocity == 0.0) {      /* Ixx34 is 1: no integration during a commanded move */
    m->integrator = fmax(-limit, fmin(limit, m->integrator + m->ixx33 * error));
  }
  return floor(output * 256.0) / 256.0 * m->peak_current / 32768.0;
}

int main(int argc, char **argv) {
  if (argc != 2 + 9 * MOTORS) {
    fprintf(stderr, "pmac: %d numbers expected\n", 1 + 9 * MOTORS);
    return 2;
  }
  const uint64_t step_tick = strtoull(argv[1], NULL, 10);
  Motor motors[MOTORS] = {0};
  for (int i = 0; i < MOTORS; ++i) {
    char **own = argv + 2 + 9 * i;
    motors[i] = (Motor){
        .step = atof(own[0]),  .ixx08 = atof(own[1]), .ixx09 = atof(own[2]),
        .ixx29 = atof(own[3]), .ixx30 = atof(own[4]), .ixx31 = atof(own[5]),
        .ixx32 = atof(own[6]), .ixx33 = atof(own[7]), .peak_current = atof(own[8])};
  }

  const rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_init_options_t init_options = rcl_get_zero_initialized_init_options();
  check(rcl_init_options_init(&init_options, allocator), "options");
  rcl_context_t context = rcl_get_zero_initialized_context();
  check(rcl_init(0, NULL, &init_options, &context), "init");
  rcl_node_t node = rcl_get_zero_initialized_node();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  check(rcl_node_init(&node, "pmac_in_c", "", &context, &node_options), "node");

  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  publisher_options.qos.depth = DEPTH; /* reliable, volatile, keep last by default */
  check(rcl_publisher_init(&publisher, &node,
                           ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, CurrentCommand),
                           "current_command", &publisher_options),
        "publisher");
  rcl_subscription_t encoders = rcl_get_zero_initialized_subscription();
  rcl_subscription_t stop = rcl_get_zero_initialized_subscription();
  rcl_subscription_options_t subscription_options = rcl_subscription_get_default_options();
  subscription_options.qos.depth = DEPTH;
  check(rcl_subscription_init(&encoders, &node,
                              ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Encoders),
                              "encoders", &subscription_options),
        "subscription");
  check(rcl_subscription_init(&stop, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Stop),
                              "stop", &subscription_options),
        "subscription");
  rcl_wait_set_t wait_set = rcl_get_zero_initialized_wait_set();
  check(rcl_wait_set_init(&wait_set, 2, 0, 0, 0, 0, 0, &context, allocator), "wait set");

  waferbot_msgs__msg__Encoders counts;
  waferbot_msgs__msg__CurrentCommand answer;
  waferbot_msgs__msg__Stop reason;
  waferbot_msgs__msg__Encoders__init(&counts);
  waferbot_msgs__msg__CurrentCommand__init(&answer);
  waferbot_msgs__msg__Stop__init(&reason);
  signal(SIGTERM, end);
  signal(SIGINT, end);

  uint64_t next_tick = 0;
  int64_t spoke_ns = 0;
  while (!asked_to_end) {
    check(rcl_wait_set_clear(&wait_set), "wait set");
    check(rcl_wait_set_add_subscription(&wait_set, &encoders, NULL), "wait set");
    check(rcl_wait_set_add_subscription(&wait_set, &stop, NULL), "wait set");
    const rcl_ret_t waited = rcl_wait(&wait_set, REPEAT_AFTER_NS);
    if (waited != RCL_RET_TIMEOUT) {
      check(waited, "wait");
    }
    rcl_reset_error();
    /* A sign of life; also for those who were not there before. What its peers repeat, who wait as well,
       wakes this node, too: so the time since it spoke counts, not that since it heard something. */
    if (next_tick > 0 && now_ns() - spoke_ns >= REPEAT_AFTER_NS) {
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
    }
    while (rcl_take(&encoders, &counts, NULL, NULL) == RCL_RET_OK) {
      if (counts.tick != next_tick || counts.valid != 0xf) {
        continue; /* no servo tick, or a repetition */
      }
      for (int i = 0; i < MOTORS; ++i) {
        if (next_tick == 0) {
          prime(&motors[i], counts.counts, i);
        }
        answer.current[i] = close_loop(&motors[i], counts.counts, i, next_tick >= step_tick);
      }
      answer.header.stamp = counts.header.stamp;
      answer.tick = counts.tick;
      answer.valid = 0x7;
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
      next_tick += SERVO_TICKS;
    }
    rcl_reset_error();
    while (rcl_take(&stop, &reason, NULL, NULL) == RCL_RET_OK) {
      fprintf(stderr, "pmac: %s stopped: %s\n", reason.node.data, reason.reason.data);
      asked_to_end = 1;
    }
    rcl_reset_error();
  }
  check(rcl_wait_set_fini(&wait_set), "end");
  check(rcl_subscription_fini(&stop, &node), "end");
  check(rcl_subscription_fini(&encoders, &node), "end");
  check(rcl_publisher_fini(&publisher, &node), "end");
  check(rcl_node_fini(&node), "end");
  check(rcl_shutdown(&context), "end");
  return 0;
}
