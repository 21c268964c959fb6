// SPDX-License-Identifier: Apache-2.0
//
// A stranger's Turbo PMAC in C++ on rclcpp: counts in, current commands out.
//
// It shares nothing with waferbot but the messages: docs/contract.md says when to speak, pmac_law.h what
// to say. Arguments as those of foreign_c/pmac.c:
//
//   pmac [--realtime] STEP_TICK  COUNTS Ixx08 Ixx09 Ixx29 Ixx30 Ixx31 Ixx32 Ixx33 PEAK_CURRENT  (three times)

#include <array>
#include <cstdio>
#include <memory>

#include "../foreign_c/pmac_law.h"
#include "node.hpp"
#include "waferbot_msgs/msg/current_command.hpp"
#include "waferbot_msgs/msg/encoders.hpp"

using waferbot_msgs::msg::CurrentCommand;
using waferbot_msgs::msg::Encoders;

class Pmac : public Peer<CurrentCommand> {
 public:
  Pmac(bool real_time, std::uint64_t step_tick, const std::array<Motor, MOTORS> &motors)
      : Peer("pmac_in_cpp", "current_command", real_time), step_tick_(step_tick), motors_(motors) {
    encoders_ = create_subscription<Encoders>("encoders", qos_of_inputs(),
                                              [this](const Encoders &counts) { take(counts); });
  }

 private:
  void take(const Encoders &counts) {
    if (counts.valid != 0xf) {
      return;
    }
    if (real_time_ && began_anew(counts.tick, next_tick_)) {
      next_tick_ = 0;
      begun_ = false;
    }
    if (real_time_ ? counts.tick < next_tick_ : counts.tick != next_tick_) {
      return;  // in real time, answered already; else no servo tick, or a repetition
    }
    const std::uint64_t tick = counts.tick / SERVO_TICKS * SERVO_TICKS;
    const double cycles =
        begun_ ? static_cast<double>((tick + SERVO_TICKS - next_tick_) / SERVO_TICKS) : 1.0;
    for (int i = 0; i < MOTORS; ++i) {
      if (!begun_) {
        prime(&motors_[i], counts.counts.data(), i);
      }
      answer_.current[i] =
          close_loop(&motors_[i], counts.counts.data(), i, tick >= step_tick_, cycles);
    }
    begun_ = true;
    const std::uint64_t stamp_ns = tick * 500000 / 9;
    answer_.header.stamp.sec = static_cast<std::int32_t>(stamp_ns / 1000000000);
    answer_.header.stamp.nanosec = static_cast<std::uint32_t>(stamp_ns % 1000000000);
    answer_.tick = tick;
    answer_.valid = 0x7;
    say();
    next_tick_ = tick + SERVO_TICKS;
  }

  const std::uint64_t step_tick_;
  std::array<Motor, MOTORS> motors_;
  rclcpp::Subscription<Encoders>::SharedPtr encoders_;
  std::uint64_t next_tick_ = 0;
  bool begun_ = false;
};

int main(int argc, char **argv) {
  Arguments arguments(argc, argv);
  if (arguments.given.size() != 2 + GIVEN * MOTORS) {
    std::fprintf(stderr, "pmac: %d numbers expected\n", 1 + GIVEN * MOTORS);
    return 2;
  }
  std::array<Motor, MOTORS> motors;
  for (int i = 0; i < MOTORS; ++i) {
    motors[i] = read_motor(arguments.given.data() + 2 + GIVEN * i);
  }
  const auto step_tick = std::strtoull(arguments.given[1], nullptr, 10);
  rclcpp::spin(std::make_shared<Pmac>(arguments.real_time, step_tick, motors));
  rclcpp::shutdown();
  return 0;
}
