/* SPDX-License-Identifier: Apache-2.0
 *
 * A stranger's three amplifiers in C on rcl: counts, commands and currents in, voltages out.
 *
 * It shares nothing with waferbot but the messages: docs/contract.md says when to speak,
 * copley_law.h what to say.
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

#include <rosidl_runtime_c/string_functions.h>

#include "copley_law.h"
#include "node.h"
#include "waferbot_msgs/msg/current_command.h"
#include "waferbot_msgs/msg/encoders.h"
#include "waferbot_msgs/msg/phase_currents.h"
#include "waferbot_msgs/msg/phase_voltages.h"
#include "waferbot_msgs/msg/stop.h"

#define PATIENCE_NS (500 * 1000 * 1000)
#define GONE_NS (2000 * (int64_t)(1000 * 1000))
#define NEVER INT64_MIN

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
    amplifiers[i] = read_amplifier(argv + 1 + GIVEN * i);
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
