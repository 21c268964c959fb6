/* SPDX-License-Identifier: Apache-2.0
 *
 * A stranger's Turbo PMAC in C on rcl: counts in, current commands out.
 *
 * It shares nothing with waferbot but the messages: docs/contract.md says when to speak, pmac_law.h
 * what to say.
 *
 *   pmac STEP_TICK  COUNTS Ixx08 Ixx09 Ixx29 Ixx30 Ixx31 Ixx32 Ixx33 PEAK_CURRENT  (nine for each motor)
 *   pmac --realtime STEP_TICK ...
 *
 * At STEP_TICK each motor is commanded to step by COUNTS from where it stood at the beginning. In real time
 * the newest counts are answered, once, with the tick of their servo cycle; what went by is made up for
 * in the law, not answered.
 */

#include "node.h"
#include "pmac_law.h"
#include "waferbot_msgs/msg/current_command.h"
#include "waferbot_msgs/msg/encoders.h"
#include "waferbot_msgs/msg/stop.h"

int main(int argc, char **argv) {
  const bool real_time = take_real_time(&argc, &argv);
  if (argc != 2 + GIVEN * MOTORS) {
    fprintf(stderr, "pmac: %d numbers expected\n", 1 + GIVEN * MOTORS);
    return 2;
  }
  const uint64_t step_tick = strtoull(argv[1], NULL, 10);
  Motor motors[MOTORS] = {0};
  for (int i = 0; i < MOTORS; ++i) {
    motors[i] = read_motor(argv + 2 + GIVEN * i);
  }

  rcl_context_t context;
  rcl_node_t node;
  begin_node(&context, &node, "pmac_in_c");
  rcl_publisher_t publisher =
      open_publisher(&node, "current_command",
                     ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, CurrentCommand));
  enum { ENCODERS, STOP, SUBSCRIPTIONS };
  rcl_subscription_t heard[SUBSCRIPTIONS] = {
      open_subscription(&node, "encoders",
                        ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Encoders)),
      open_subscription(&node, "stop", ROSIDL_GET_MSG_TYPE_SUPPORT(waferbot_msgs, msg, Stop)),
  };
  rcl_wait_set_t wait_set = open_wait_set(&context, SUBSCRIPTIONS);

  waferbot_msgs__msg__Encoders counts;
  waferbot_msgs__msg__CurrentCommand answer;
  waferbot_msgs__msg__Stop reason;
  waferbot_msgs__msg__Encoders__init(&counts);
  waferbot_msgs__msg__CurrentCommand__init(&answer);
  waferbot_msgs__msg__Stop__init(&reason);

  uint64_t next_tick = 0;
  bool begun = false;
  int64_t spoke_ns = 0;
  while (!asked_to_end) {
    wait_for_messages(&wait_set, heard, SUBSCRIPTIONS, REPEAT_AFTER_NS);
    /* A sign of life; also for those who were not there before. What its peers repeat, who wait as well,
       wakes this node, too: so the time since it spoke counts, not that since it heard something. */
    if (next_tick > 0 && now_ns() - spoke_ns >= REPEAT_AFTER_NS) {
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
    }
    bool more = take(&heard[ENCODERS], &counts);
    while (more) {
      if (counts.valid != 0xf) {
        more = take(&heard[ENCODERS], &counts);
        continue;
      }
      if (real_time && began_anew(counts.tick, next_tick)) {
        next_tick = 0;
        begun = false;
      }
      const waferbot_msgs__msg__Encoders newest = counts; /* its frame_id is empty: nothing is shared */
      more = take(&heard[ENCODERS], &counts);
      if (real_time ? more || newest.tick < next_tick : newest.tick != next_tick) {
        continue; /* in real time, there are newer ones; else no servo tick; or a repetition */
      }
      const uint64_t tick = newest.tick / SERVO_TICKS * SERVO_TICKS;
      const double cycles = begun ? (double)((tick + SERVO_TICKS - next_tick) / SERVO_TICKS) : 1.0;
      for (int i = 0; i < MOTORS; ++i) {
        if (!begun) {
          prime(&motors[i], newest.counts, i);
        }
        answer.current[i] = close_loop(&motors[i], newest.counts, i, tick >= step_tick, cycles);
      }
      begun = true;
      const uint64_t stamp_ns = tick * 500000 / 9;
      answer.header.stamp.sec = (int32_t)(stamp_ns / 1000000000);
      answer.header.stamp.nanosec = (uint32_t)(stamp_ns % 1000000000);
      answer.tick = tick;
      answer.valid = 0x7;
      check(rcl_publish(&publisher, &answer, NULL), "publish");
      spoke_ns = now_ns();
      next_tick = tick + SERVO_TICKS;
    }
    while (take(&heard[STOP], &reason)) {
      fprintf(stderr, "pmac: %s stopped: %s\n", reason.node.data, reason.reason.data);
      asked_to_end = 1;
    }
  }
  check(rcl_wait_set_fini(&wait_set), "end");
  for (int i = 0; i < SUBSCRIPTIONS; ++i) {
    check(rcl_subscription_fini(&heard[i], &node), "end");
  }
  check(rcl_publisher_fini(&publisher, &node), "end");
  end_node(&context, &node);
  return 0;
}
