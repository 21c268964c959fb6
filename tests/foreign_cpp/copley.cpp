// SPDX-License-Identifier: Apache-2.0
//
// A stranger's three amplifiers in C++ on rclcpp: counts, commands and currents in, voltages out.
//
// It shares nothing with waferbot but the messages: docs/contract.md says when to speak, copley_law.h what
// to say. Arguments, and what it does in real time, as foreign_c/copley.c:
//
//   copley [--realtime] ENCODER COUNTS_PER_CYCLE PROPORTIONAL INTEGRAL BUS PEAK RESISTANCE  (three times)

#include <array>
#include <cstdio>
#include <memory>
#include <optional>
#include <thread>

#include "../foreign_c/copley_law.h"
#include "node.hpp"
#include "waferbot_msgs/msg/current_command.hpp"
#include "waferbot_msgs/msg/encoders.hpp"
#include "waferbot_msgs/msg/phase_currents.hpp"
#include "waferbot_msgs/msg/phase_voltages.hpp"

using waferbot_msgs::msg::CurrentCommand;
using waferbot_msgs::msg::Encoders;
using waferbot_msgs::msg::PhaseCurrents;
using waferbot_msgs::msg::PhaseVoltages;
using waferbot_msgs::msg::Stop;

constexpr auto PATIENCE = std::chrono::milliseconds(500);  // half of that which the plant is given
constexpr auto GONE = std::chrono::seconds(2);             // who is silent for so long is not waited for

// The newest message of a topic, whether it is there for the tick that comes next, and when it came.
template <typename Message>
struct Newest {
  Message message;
  bool is_there = false;
  std::optional<Clock::time_point> came;

  // Whether it is the one that is due at a tick, or its sender is gone.
  bool is_due(std::uint64_t tick, std::uint64_t spacing) const {
    return message.tick >= tick / spacing * spacing || Clock::now() - *came > GONE;
  }
};

class Copley : public Peer<PhaseVoltages> {
 public:
  Copley(bool real_time, const std::array<Amplifier, MOTORS> &amplifiers)
      : Peer("copley_in_cpp", "phase_voltages", real_time),
        amplifiers_(amplifiers),
        stopper_(create_publisher<Stop>("stop", qos(DEPTH))) {
    listen("phase_currents", 0x7, currents_, currents_topic_);
    listen("encoders", 0xf, counts_, counts_topic_);
    listen("current_command", 0x7, command_, command_topic_);
    if (real_time) {
      patience_ = create_wall_timer(PATIENCE / 50, [this] { answer_if_complete(); });
    }
  }

  bool refused() const { return refused_; }

 private:
  // In lock-step each topic has one message that is due: the next comes only when this tick is answered.
  // What comes beside it is a repetition, or of a node that does not keep the contract.
  template <typename Message>
  void listen(const char *topic, std::uint32_t whole, Newest<Message> &newest,
              typename rclcpp::Subscription<Message>::SharedPtr &subscription) {
    subscription = create_subscription<Message>(
        topic, qos_of_inputs(), [this, whole, &newest](const Message &message) {
          if (message.valid != whole) {
            return;
          }
          const bool are_currents = static_cast<void *>(&newest) == &currents_;
          if (real_time_ && are_currents && began_anew(message.tick, tick_)) {
            tick_ = 0;
            begun_ = false;
            counts_.is_there = false;
          }
          if (real_time_ ? !are_currents || message.tick >= tick_
                         : message.tick == tick_ && !newest.is_there) {
            if (!are_currents || !newest.is_there) {
              newest.came = Clock::now();  // of currents, since when they wait
            }
            newest.message = message;
            newest.is_there = true;
            answer_if_complete();
          }
        });
  }

  bool complete() const {
    if (!currents_.is_there) {
      return false;
    }
    if (!real_time_) {
      return (counts_.is_there || tick_ % ENCODER_TICKS) && (command_.is_there || tick_ % SERVO_TICKS);
    }
    const std::uint64_t tick = currents_.message.tick;
    return counts_.is_there && command_.came &&
           (Clock::now() - *currents_.came > PATIENCE ||
            (counts_.is_due(tick, ENCODER_TICKS) && command_.is_due(tick, SERVO_TICKS)));
  }

  void answer_if_complete() {
    if (refused_ || !complete()) {
      return;
    }
    const PhaseCurrents &currents = currents_.message;
    if (!all_finite(currents.current.data(), LINES * MOTORS)) {
      return refuse("phase_currents");
    }
    if (!all_finite(command_.message.current.data(), MOTORS)) {
      return refuse("current_command");
    }
    const double ticks = static_cast<double>(currents.tick + 1 - tick_);
    for (int i = 0; i < MOTORS; ++i) {
      close_loop(&amplifiers_[i], !begun_, begun_ ? ticks : 1.0, counts_.message.counts.data(),
                 command_.message.current[i], currents.current.data() + LINES * i,
                 answer_.voltage.data() + 3 * i);
    }
    begun_ = true;
    answer_.header.stamp = currents.header.stamp;
    answer_.tick = currents.tick;
    answer_.valid = 0x7;
    answer_.open = 0;
    say();
    tick_ = currents.tick + 1;
    currents_.is_there = false;
    counts_.is_there = counts_.is_there && (real_time_ || tick_ % ENCODER_TICKS != 0);
    command_.is_there = command_.is_there && tick_ % SERVO_TICKS != 0;
  }

  // Say it several times, for those who are still being discovered, and end.
  void refuse(const char *topic) {
    refused_ = true;
    Stop stop;
    stop.header.stamp = currents_.message.header.stamp;
    stop.tick = tick_;
    stop.node = get_fully_qualified_name();
    stop.reason = std::string("topic ") + topic + ", tick " + std::to_string(tick_) +
                  ": no finite number";
    RCLCPP_ERROR(get_logger(), "%s", stop.reason.c_str());
    for (int i = 0; i < 3; ++i) {
      stopper_->publish(stop);
      std::this_thread::sleep_for(REPEAT_AFTER);
    }
    rclcpp::shutdown();
  }

  std::array<Amplifier, MOTORS> amplifiers_;
  rclcpp::Publisher<Stop>::SharedPtr stopper_;
  Newest<PhaseCurrents> currents_;
  Newest<Encoders> counts_;
  Newest<CurrentCommand> command_;
  rclcpp::Subscription<PhaseCurrents>::SharedPtr currents_topic_;
  rclcpp::Subscription<Encoders>::SharedPtr counts_topic_;
  rclcpp::Subscription<CurrentCommand>::SharedPtr command_topic_;
  rclcpp::TimerBase::SharedPtr patience_;
  std::uint64_t tick_ = 0;  // whose voltages come next
  bool begun_ = false, refused_ = false;
};

int main(int argc, char **argv) {
  Arguments arguments(argc, argv);
  if (arguments.given.size() != 1 + GIVEN * MOTORS) {
    std::fprintf(stderr, "copley: %d numbers expected\n", GIVEN * MOTORS);
    return 2;
  }
  std::array<Amplifier, MOTORS> amplifiers;
  for (int i = 0; i < MOTORS; ++i) {
    amplifiers[i] = read_amplifier(arguments.given.data() + 1 + GIVEN * i);
  }
  const auto node = std::make_shared<Copley>(arguments.real_time, amplifiers);
  rclcpp::spin(node);
  rclcpp::shutdown();
  return node->refused();
}
