// SPDX-License-Identifier: Apache-2.0
//
// What a node in C++ on rclcpp needs whatever it does: quality of service, signs of life, the end.

#ifndef FOREIGN_CPP_NODE_HPP
#define FOREIGN_CPP_NODE_HPP

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <rclcpp/rclcpp.hpp>

#include "waferbot_msgs/msg/stop.hpp"

using Clock = std::chrono::steady_clock;

constexpr std::size_t DEPTH = 1024;       // of all topics, both ways: docs/contract.md, Messages
constexpr std::uint64_t HORIZON = 1024;   // ticks; what is further back is of another run
constexpr auto REPEAT_AFTER = std::chrono::milliseconds(100);  // ten times a second, while it waits

// A node that answers its peers, repeats its last answer while it waits, and ends when one of them does.
template <typename Answer>
class Peer : public rclcpp::Node {
 public:
  Peer(const std::string &name, const std::string &topic, bool real_time)
      : Node(name), real_time_(real_time), publisher_(create_publisher<Answer>(topic, qos(DEPTH))) {
    stop_ = create_subscription<waferbot_msgs::msg::Stop>(
        "stop", qos(DEPTH), [this](const waferbot_msgs::msg::Stop &stop) {
          RCLCPP_ERROR(get_logger(), "%s stopped: %s", stop.node.c_str(), stop.reason.c_str());
          rclcpp::shutdown();
        });
    timer_ = create_wall_timer(REPEAT_AFTER / 2, [this] {
      if (said_ && Clock::now() - spoke_ >= REPEAT_AFTER) {
        say();
      }
    });
  }

 protected:
  static rclcpp::QoS qos(std::size_t depth) { return rclcpp::QoS(rclcpp::KeepLast(depth)).reliable(); }

  // In real time only the newest counts; who worked off all that came would fall further behind.
  rclcpp::QoS qos_of_inputs() const { return qos(real_time_ ? 1 : DEPTH); }

  void say() {
    publisher_->publish(answer_);
    spoke_ = Clock::now();
    said_ = true;
  }

  // Whether time has begun anew: two messages in a row of tick 0, or of long before the newest.
  bool began_anew(std::uint64_t tick, std::uint64_t next_tick) {
    const bool back = next_tick > 0 && (tick == 0 || tick + HORIZON < next_tick);
    far_back_ = back ? far_back_ + 1 : 0;
    return far_back_ > 1;
  }

  const bool real_time_;
  Answer answer_;

 private:
  typename rclcpp::Publisher<Answer>::SharedPtr publisher_;
  rclcpp::Subscription<waferbot_msgs::msg::Stop>::SharedPtr stop_;
  rclcpp::TimerBase::SharedPtr timer_;
  Clock::time_point spoke_;
  bool said_ = false;
  int far_back_ = 0;
};

// Arguments without those of ROS; --realtime is taken off.
struct Arguments {
  Arguments(int argc, char **argv) : all(rclcpp::init_and_remove_ros_arguments(argc, argv)) {
    if (all.size() > 1 && all[1] == "--realtime") {
      real_time = true;
      all.erase(all.begin() + 1);
    }
    for (auto &one : all) {
      given.push_back(one.data());
    }
  }

  std::vector<std::string> all;
  std::vector<char *> given;
  bool real_time = false;
};

#endif
