/* SPDX-License-Identifier: Apache-2.0
 *
 * What a node in C on rcl needs whatever it does: names, quality of service, waiting, the end.
 */

#ifndef FOREIGN_C_NODE_H
#define FOREIGN_C_NODE_H

#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <rcl/rcl.h>
#include <rcl/error_handling.h>

enum { DEPTH = 1024 }; /* of all topics, both ways: docs/contract.md, Messages */
enum { HORIZON = 1024 }; /* ticks; what is further back is of another run */

#define REPEAT_AFTER_NS (100 * 1000 * 1000) /* ten times a second, while it waits */

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
    fprintf(stderr, "%s: %s\n", what, rcl_get_error_string().str);
    exit(1);
  }
}

/* Begin a node in the domain of ROS_DOMAIN_ID that ends by SIGINT and SIGTERM. */
static void begin_node(rcl_context_t *context, rcl_node_t *node, const char *name) {
  rcl_init_options_t init_options = rcl_get_zero_initialized_init_options();
  check(rcl_init_options_init(&init_options, rcl_get_default_allocator()), "options");
  *context = rcl_get_zero_initialized_context();
  check(rcl_init(0, NULL, &init_options, context), "init");
  *node = rcl_get_zero_initialized_node();
  const rcl_node_options_t node_options = rcl_node_get_default_options();
  check(rcl_node_init(node, name, "", context, &node_options), "node");
  signal(SIGTERM, end);
  signal(SIGINT, end);
}

static rcl_publisher_t open_publisher(const rcl_node_t *node, const char *topic,
                                      const rosidl_message_type_support_t *type) {
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  options.qos.depth = DEPTH; /* reliable, volatile, keep last by default */
  check(rcl_publisher_init(&publisher, node, type, topic, &options), topic);
  return publisher;
}

static rcl_subscription_t open_subscription(const rcl_node_t *node, const char *topic,
                                            const rosidl_message_type_support_t *type) {
  rcl_subscription_t subscription = rcl_get_zero_initialized_subscription();
  rcl_subscription_options_t options = rcl_subscription_get_default_options();
  options.qos.depth = DEPTH;
  check(rcl_subscription_init(&subscription, node, type, topic, &options), topic);
  return subscription;
}

static rcl_wait_set_t open_wait_set(rcl_context_t *context, size_t subscriptions) {
  rcl_wait_set_t wait_set = rcl_get_zero_initialized_wait_set();
  check(rcl_wait_set_init(&wait_set, subscriptions, 0, 0, 0, 0, 0, context,
                          rcl_get_default_allocator()),
        "wait set");
  return wait_set;
}

/* Wait until one of the subscriptions has a message, or for so long. */
static void wait_for_messages(rcl_wait_set_t *wait_set, const rcl_subscription_t *subscriptions,
                              int count, int64_t timeout_ns) {
  check(rcl_wait_set_clear(wait_set), "wait set");
  for (int i = 0; i < count; ++i) {
    check(rcl_wait_set_add_subscription(wait_set, &subscriptions[i], NULL), "wait set");
  }
  const rcl_ret_t waited = rcl_wait(wait_set, timeout_ns);
  if (waited != RCL_RET_TIMEOUT) {
    check(waited, "wait");
  }
  rcl_reset_error();
}

/* Take the next message, if there is one. */
static bool take(const rcl_subscription_t *subscription, void *message) {
  if (rcl_take(subscription, message, NULL, NULL) == RCL_RET_OK) {
    return true;
  }
  rcl_reset_error();
  return false;
}

/* Take the option --realtime off the arguments; tell whether it was there. */
static bool take_real_time(int *argc, char ***argv) {
  if (*argc < 2 || strcmp((*argv)[1], "--realtime") != 0) {
    return false;
  }
  *argc -= 1;
  *argv += 1;
  return true;
}

/* Whether time has begun anew: two messages in a row of tick 0, or of long before the newest. */
static bool began_anew(uint64_t tick, uint64_t next_tick) {
  static int far_back = 0;
  const bool back = next_tick > 0 && (tick == 0 || tick + HORIZON < next_tick);
  far_back = back ? far_back + 1 : 0;
  return far_back > 1;
}

static void end_node(rcl_context_t *context, rcl_node_t *node) {
  check(rcl_node_fini(node), "end");
  check(rcl_shutdown(context), "end");
}

#endif
