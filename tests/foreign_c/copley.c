/* SPDX-License-Identifier: Apache-2.0
 *
 * A stranger's three amplifiers in C on rcl: counts, commands and currents in, voltages out.
 *
 * It shares nothing with waferbot but the messages: docs/contract.md says when to speak, and under "The
 * same bits" what to compute in which order; compile without fused multiply-add (-ffp-contract=off).
 * The current loop is that of the thesis; of a drive's protections it has none but the peak current.
 *
 *   copley  ENCODER COUNTS_PER_CYCLE PROPORTIONAL INTEGRAL BUS PEAK RESISTANCE  (seven for each motor)
 *   copley --realtime ENCODER ...
 *
 * ENCODER is the place of the motor's encoder in `counts`; PROPORTIONAL (V) and INTEGRAL (V per tick)
 * are for a duty of 32, BUS in V, PEAK in A, RESISTANCE that of one line, ohm. In real time the newest
 * currents are answered, once, with the counts and the command of their tick, or the newest if these do not
 * come within 0.5 s, half of the patience that the plant is given; ticks that went by are made up for in
 * the integrators, not answered. Who has been silent for 2 s is not waited for, but the first command is:
 * it enables the amplifiers.
 */

#include <math.h>

#include <rosidl_runtime_c/string_functions.h>

#include "node.h"
#include "waferbot_msgs/msg/current_command.h"
#include "waferbot_msgs/msg/encoders.h"
#include "waferbot_msgs/msg/phase_currents.h"
#include "waferbot_msgs/msg/phase_voltages.h"
#include "waferbot_msgs/msg/stop.h"

enum { MOTORS = 3, LINES = 2, GIVEN = 7, ENCODER_TICKS = 2, SERVO_TICKS = 8 };

#define DUTY 32.0
#define PATIENCE_NS (500 * 1000 * 1000)
#define GONE_NS (2000 * (int64_t)(1000 * 1000))
#define NEVER INT64_MIN

typedef struct {
  double encoder, counts_per_cycle, proportional, integral, bus, peak, resistance; /* as given */
  double sum[LINES]; /* integrators of lines 1 and 2 */
} Amplifier;

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

/* Whether a message is the one that is due at a tick, or its sender is gone. */
static bool is_due(uint64_t its_tick, uint64_t tick, uint64_t spacing, int64_t silence_ns) {
  return its_tick >= tick / spacing * spacing || silence_ns > GONE_NS;
}

int main(int argc, char **argv) {
  const bool real_time = take_real_time(&argc, &argv);
  if (argc != 1 + GIVEN * MOTORS) {
    fprintf(stderr, "copley: %d numbers expected\n", GIVEN * MOTORS);
    return 2;
  }
  Amplifier amplifiers[MOTORS] = {0};
  for (int i = 0; i < MOTORS; ++i) {
    char **own = argv + 1 + GIVEN * i;
    amplifiers[i] = (Amplifier){
        .encoder = atof(own[0]), .counts_per_cycle = atof(own[1]), .proportional = atof(own[2]),
        .integral = atof(own[3]), .bus = atof(own[4]), .peak = atof(own[5]),
        .resistance = atof(own[6])};
  }

  rcl_context_t context;
  rcl_node_t node;
  begin_node(&context, &node, "copley_in_c");
  rcl_publisher_t publisher =
      open_publisher(&node, "phase_voltages",
                     ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, PhaseVoltages));
  rcl_publisher_t stopper = open_publisher(
      &node, "stop", ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Stop));
  enum { CURRENTS, ENCODERS, COMMAND, STOP, SUBSCRIPTIONS };
  rcl_subscription_t heard[SUBSCRIPTIONS] = {
      open_subscription(&node, "phase_currents",
                        ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, PhaseCurrents)),
      open_subscription(&node, "encoders",
                        ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Encoders)),
      open_subscription(&node, "current_command",
                        ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, CurrentCommand)),
      open_subscription(&node, "stop", ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Stop)),
  };
  rcl_wait_set_t wait_set = open_wait_set(&context, SUBSCRIPTIONS);

  waferbot_msgs__msg__PhaseCurrents currents, new_currents;
  waferbot_msgs__msg__Encoders counts, new_counts;
  waferbot_msgs__msg__CurrentCommand command, new_command;
  waferbot_msgs__msg__PhaseVoltages answer;
  waferbot_msgs__msg__Stop reason;
  waferbot_msgs__msg__PhaseCurrents__init(&currents);
  waferbot_msgs__msg__PhaseCurrents__init(&new_currents);
  waferbot_msgs__msg__Encoders__init(&counts);
  waferbot_msgs__msg__Encoders__init(&new_counts);
  waferbot_msgs__msg__CurrentCommand__init(&command);
  waferbot_msgs__msg__CurrentCommand__init(&new_command);
  waferbot_msgs__msg__PhaseVoltages__init(&answer);
  waferbot_msgs__msg__Stop__init(&reason);

  uint64_t tick = 0; /* whose voltages come next */
  bool begun = false, have_currents = false, have_counts = false, have_command = false;
  const char *refused = NULL;
  int64_t spoke_ns = 0, came_ns = 0, counts_ns = -GONE_NS, command_ns = NEVER;
  while (!asked_to_end) {
    wait_for_messages(&wait_set, heard, SUBSCRIPTIONS,
                      real_time && have_currents ? PATIENCE_NS / 50 : REPEAT_AFTER_NS);
    if (begun && now_ns() - spoke_ns >= REPEAT_AFTER_NS) { /* a sign of life */
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
    }
    /* In lock-step each topic has one message that is due: the next comes only when this tick is answered.
       What comes beside it is a repetition, or of a node that does not keep the contract. */
    while (take(&heard[CURRENTS], &new_currents)) {
      if (real_time && new_currents.valid == 0x7 && began_anew(new_currents.tick, tick)) {
        tick = 0;
        begun = have_counts = false;
      }
      const bool due = real_time ? new_currents.tick >= tick : new_currents.tick == tick && !have_currents;
      if (due && new_currents.valid == 0x7) {
        currents = new_currents; /* its frame_id is empty, so nothing is shared */
        came_ns = have_currents ? came_ns : now_ns();
        have_currents = true;
      }
    }
    while (take(&heard[ENCODERS], &new_counts)) {
      if ((real_time || (new_counts.tick == tick && !have_counts)) && new_counts.valid == 0xf) {
        counts = new_counts;
        counts_ns = now_ns();
        have_counts = true;
      }
    }
    while (take(&heard[COMMAND], &new_command)) {
      if ((real_time || (new_command.tick == tick && !have_command)) && new_command.valid == 0x7) {
        command = new_command;
        command_ns = now_ns();
        have_command = true;
      }
    }
    bool complete = have_currents && (have_counts || tick % ENCODER_TICKS) &&
                    (have_command || tick % SERVO_TICKS);
    if (real_time) {
      const int64_t now = now_ns();
      complete = have_currents && have_counts && command_ns != NEVER &&
                 (now - came_ns > PATIENCE_NS ||
                  (is_due(counts.tick, currents.tick, ENCODER_TICKS, now - counts_ns) &&
                   is_due(command.tick, currents.tick, SERVO_TICKS, now - command_ns)));
    }
    if (complete) {
      if (!all_finite(currents.current, LINES * MOTORS)) {
        refused = "phase_currents";
      } else if (!all_finite(command.current, MOTORS)) {
        refused = "current_command";
      }
      if (refused != NULL) {
        break;
      }
      const double ticks = (double)(currents.tick + 1 - tick);
      for (int i = 0; i < MOTORS; ++i) {
        close_loop(&amplifiers[i], !begun, begun ? ticks : 1.0, counts.counts, command.current[i],
                   currents.current + LINES * i, answer.voltage + 3 * i);
      }
      begun = true;
      answer.header.stamp = currents.header.stamp;
      answer.tick = currents.tick;
      answer.valid = 0x7;
      answer.open = 0;
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
      tick = currents.tick + 1;
      have_currents = false;
      have_counts = have_counts && (real_time || tick % ENCODER_TICKS != 0);
      have_command = have_command && tick % SERVO_TICKS != 0;
    }
    while (take(&heard[STOP], &reason)) {
      fprintf(stderr, "copley: %s stopped: %s\n", reason.node.data, reason.reason.data);
      asked_to_end = 1;
    }
  }
  if (refused != NULL) { /* said several times, for those who are still being discovered */
    char text[160];
    snprintf(text, sizeof text, "topic %s, tick %llu: no finite number", refused,
             (unsigned long long)tick);
    fprintf(stderr, "copley: %s\n", text);
    reason.header.stamp = currents.header.stamp;
    reason.tick = tick;
    rosidl_runtime_c__String__assign(&reason.node, rcl_node_get_fully_qualified_name(&node));
    rosidl_runtime_c__String__assign(&reason.reason, text);
    for (int i = 0; i < 3; ++i) {
      check(rcl_publish(&stopper, &reason, NULL), "publish");
      nanosleep(&(struct timespec){.tv_nsec = REPEAT_AFTER_NS}, NULL);
    }
  }
  check(rcl_wait_set_fini(&wait_set), "end");
  for (int i = 0; i < SUBSCRIPTIONS; ++i) {
    check(rcl_subscription_fini(&heard[i], &node), "end");
  }
  check(rcl_publisher_fini(&publisher, &node), "end");
  check(rcl_publisher_fini(&stopper, &node), "end");
  end_node(&context, &node);
  return refused != NULL;
}
