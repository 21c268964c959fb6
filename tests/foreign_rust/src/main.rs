// SPDX-License-Identifier: Apache-2.0
//! A stranger's Turbo PMAC in Rust: counts in, current commands out.
//!
//! It shares nothing with waferbot, not even the generated messages or the middleware: ros2-client
//! and RustDDS are another implementation of ROS 2's topics than the one below rclpy. docs/contract.md
//! and the message definitions say when to speak and in which bytes, the Turbo PMAC User Manual ("Actual
//! PID Algorithm") what to say. Its sums are of whole numbers, so that f64 carries them exactly, in
//! whatever order.
//!
//!     foreign-pmac [--realtime] STEP_TICK  COUNTS Ixx08 Ixx09 Ixx29 Ixx30 Ixx31 Ixx32 Ixx33 PEAK_CURRENT
//!
//! with the last nine for each motor. At STEP_TICK each motor is commanded to step by COUNTS from where
//! it stood at the beginning. In real time the newest counts are answered, once, with the tick of their
//! servo cycle; what went by is made up for in the law, not answered.

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
    Subscription,
};
use rustdds::DomainParticipantBuilder;
use rustdds::mio1::{Events, Interest, Poll, Token};
use serde::{Deserialize, Serialize};

const MOTORS: usize = 3;
const SERVO_TICKS: u64 = 8;
const DEPTH: usize = 1024;
const HORIZON: u64 = 1024; // ticks; what is further back is of another run
const REPEAT_AFTER: Duration = Duration::from_millis(100); // ten times a second, while it waits
const INTEGRATOR_UNITS: f64 = 8388608.0; // 2^23
const INTEGRATOR_LIMIT: f64 = 4194304.0; // Ixx63, 1/16 count
const OUTPUT_LIMIT: f64 = 32767.0; // Ixx69, DAC bits

/// Places in `counts` of each motor's encoder for position (Ixx03) and velocity (Ixx04).
const POSITION: [usize; MOTORS] = [0, 1, 2];
const VELOCITY: [usize; MOTORS] = [0, 1, 3]; // the last motor has two encoders

/// The messages, field by field as their definitions have them.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Header {
    sec: i32,
    nanosec: u32,
    frame_id: String,
}

#[derive(Deserialize)]
#[allow(dead_code)] // all fields are on the wire, whether or not they are read here
struct Encoders {
    header: Header,
    tick: u64,
    valid: u8,
    counts: [i64; 4],
}

#[derive(Clone, Debug, Serialize)]
struct CurrentCommand {
    header: Header,
    tick: u64,
    valid: u8,
    current: [f64; MOTORS],
}

#[derive(Deserialize)]
#[allow(dead_code)]
struct Stop {
    header: Header,
    tick: u64,
    node: String,
    reason: String,
}

/// One motor: what it is told, and the law's registers from the cycle before.
struct Motor {
    step: f64,
    ixx08: f64,
    ixx09: f64,
    ixx29: f64,
    ixx30: f64,
    ixx31: f64,
    ixx32: f64,
    ixx33: f64,
    peak_current: f64,
    start: f64, // counts
    command: f64,
    velocity_feedback: f64,
    integrator: f64,
}

impl Motor {
    fn new(given: &[f64]) -> Motor {
        Motor {
            step: given[0],
            ixx08: given[1],
            ixx09: given[2],
            ixx29: given[3],
            ixx30: given[4],
            ixx31: given[5],
            ixx32: given[6],
            ixx33: given[7],
            peak_current: given[8],
            start: 0.0,
            command: 0.0,
            velocity_feedback: 0.0,
            integrator: 0.0,
        }
    }

    /// Close the loop where the motor stands: no velocity, no integral.
    fn prime(&mut self, position: i64, velocity: i64) {
        self.start = position as f64;
        self.command = (self.start * 32.0 * self.ixx08 + 0.5).floor();
        self.velocity_feedback = velocity as f64 * 32.0 * self.ixx09;
        self.integrator = 0.0;
    }

    /// Run the servo, `cycles` after it was last run; return the current, A.
    fn close_loop(&mut self, position: i64, velocity: i64, stepped: bool, cycles: f64) -> f64 {
        let scale = 32.0 * self.ixx08;
        let limit = INTEGRATOR_LIMIT * 2.0 * self.ixx08 * INTEGRATOR_UNITS;
        let target = self.start + if stepped { self.step } else { 0.0 };
        let command = (target * scale + 0.5).floor();
        let command_velocity = (command - self.command) / cycles;
        let feedback = velocity as f64 * 32.0 * self.ixx09;
        let actual_velocity = (feedback - self.velocity_feedback) / cycles;
        let error = command - position as f64 * scale;
        let damping = (self.ixx32 * command_velocity - self.ixx31 * actual_velocity) / 128.0;
        let total = error + damping + self.integrator / INTEGRATOR_UNITS;
        let mut output = self.ixx30 / 16777216.0 * total + self.ixx29;
        self.command = command;
        self.velocity_feedback = feedback;
        if output.abs() >= OUTPUT_LIMIT {
            output = OUTPUT_LIMIT.copysign(output); // and the integrator is held
        } else if command_velocity == 0.0 {
            // Ixx34 is 1: no integration during a commanded move
            self.integrator = (self.integrator + self.ixx33 * error * cycles).clamp(-limit, limit);
        }
        (output * 256.0).floor() / 256.0 * self.peak_current / 32768.0
    }
}

/// The servo: answers the encoders of each servo tick, once and in order; in real time the newest.
struct Pmac {
    motors: Vec<Motor>,
    step_tick: u64,
    next_tick: u64,
    real_time: bool,
    begun: bool,
    far_back: u32, // messages in a row of tick 0, or of long before the newest
}

impl Pmac {
    /// Whether time has begun anew: two messages in a row that are far back.
    fn began_anew(&mut self, tick: u64) -> bool {
        let back = self.next_tick > 0 && (tick == 0 || tick + HORIZON < self.next_tick);
        self.far_back = if back { self.far_back + 1 } else { 0 };
        self.far_back > 1
    }

    /// Answer what has come, in the order in which it came.
    fn answer(&mut self, heard: &[Encoders]) -> Vec<CurrentCommand> {
        if !self.real_time {
            return heard.iter().filter_map(|one| self.servo(one)).collect();
        }
        let mut newest = None;
        for encoders in heard.iter().filter(|one| one.valid == 0xf) {
            if self.began_anew(encoders.tick) {
                self.next_tick = 0;
                self.begun = false;
            }
            newest = Some(encoders);
        }
        newest.and_then(|one| self.servo(one)).into_iter().collect()
    }

    /// Close the loops at a servo tick that has not been answered.
    fn servo(&mut self, encoders: &Encoders) -> Option<CurrentCommand> {
        let due = if self.real_time {
            encoders.tick >= self.next_tick
        } else {
            encoders.tick == self.next_tick // else no servo tick, or a repetition
        };
        if !due || encoders.valid != 0xf {
            return None;
        }
        let tick = encoders.tick / SERVO_TICKS * SERVO_TICKS;
        let cycles = if self.begun {
            ((tick + SERVO_TICKS - self.next_tick) / SERVO_TICKS) as f64
        } else {
            1.0
        };
        let mut current = [0.0; MOTORS];
        for (place, motor) in self.motors.iter_mut().enumerate() {
            let position = encoders.counts[POSITION[place]];
            let velocity = encoders.counts[VELOCITY[place]];
            if !self.begun {
                motor.prime(position, velocity);
            }
            current[place] = motor.close_loop(position, velocity, tick >= self.step_tick, cycles);
        }
        self.begun = true;
        self.next_tick = tick + SERVO_TICKS;
        let stamp_ns = tick * 500_000 / 9;
        Some(CurrentCommand {
            header: Header {
                sec: (stamp_ns / 1_000_000_000) as i32,
                nanosec: (stamp_ns % 1_000_000_000) as u32,
                frame_id: String::new(),
            },
            tick,
            valid: 0x7,
            current,
        })
    }
}

fn main() {
    let mut words: Vec<String> = std::env::args().skip(1).collect();
    let real_time = words.first().is_some_and(|word| word == "--realtime");
    if real_time {
        words.remove(0);
    }
    let given: Vec<f64> = words
        .iter()
        .map(|word| {
            word.parse()
                .unwrap_or_else(|_| panic!("{word:?} is no number"))
        })
        .collect();
    assert_eq!(given.len(), 1 + 9 * MOTORS, "numbers expected");
    let mut pmac = Pmac {
        motors: given[1..].chunks(9).map(Motor::new).collect(),
        step_tick: given[0] as u64,
        next_tick: 0,
        real_time,
        begun: false,
        far_back: 0,
    };
    let asked_to_end = Arc::new(AtomicBool::new(false));
    let end = asked_to_end.clone();
    ctrlc::set_handler(move || end.store(true, Ordering::Relaxed)).expect("signals");

    let domain =
        std::env::var("ROS_DOMAIN_ID").map_or(0, |number| number.parse().expect("ROS_DOMAIN_ID"));
    // The twin is on the loopback interface alone.
    let participant = DomainParticipantBuilder::new(domain)
        .with_only_networks([Ipv4Addr::LOCALHOST])
        .build()
        .expect("participant");
    let context = Context::from_domain_participant(participant).expect("context");
    let mut node = context
        .new_node(
            NodeName::new("/", "pmac_in_rust").unwrap(),
            NodeOptions::new(),
        )
        .expect("node");
    let command = publisher(&mut node);
    let mut encoders: Subscription<Encoders> = subscription(&mut node, "encoders", "Encoders");
    let mut stop: Subscription<Stop> = subscription(&mut node, "stop", "Stop");

    let mut poll = Poll::new().expect("poll");
    let registry = poll.registry();
    registry
        .register(&mut encoders, Token(0), Interest::READABLE)
        .expect("poll");
    registry
        .register(&mut stop, Token(1), Interest::READABLE)
        .expect("poll");
    let mut events = Events::with_capacity(8);
    let mut last: Option<CurrentCommand> = None;
    let mut spoke = Instant::now();
    while !asked_to_end.load(Ordering::Relaxed) {
        // What has come is taken to the last before it waits again: readiness is told once.
        if let Err(error) = poll.poll(&mut events, Some(REPEAT_AFTER)) {
            assert_eq!(error.kind(), std::io::ErrorKind::Interrupted, "{error}");
        }
        let mut heard = Vec::new();
        while let Some((message, _)) = encoders.take().expect("encoders") {
            heard.push(message);
        }
        for answer in pmac.answer(&heard) {
            command.publish(answer.clone()).expect("publish");
            spoke = Instant::now();
            last = Some(answer);
        }
        // A sign of life; also for those who were not there before.
        if let Some(answer) = last.as_ref().filter(|_| spoke.elapsed() >= REPEAT_AFTER) {
            command.publish(answer.clone()).expect("publish");
            spoke = Instant::now();
        }
        while let Some((message, _)) = stop.take().expect("stop") {
            eprintln!("pmac: {} stopped: {}", message.node, message.reason);
            asked_to_end.store(true, Ordering::Relaxed);
        }
    }
}

fn qos() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Wait(Duration::from_secs(1)))
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: DEPTH })
}

fn publisher(node: &mut Node) -> Publisher<CurrentCommand> {
    let name = Name::new("/", "current_command").unwrap();
    let kind = MessageTypeName::new("waferbot_msgs", "CurrentCommand");
    let topic = node.create_topic(&name, kind, &qos()).expect("topic");
    node.create_publisher(&topic, None).expect("publisher")
}

fn subscription<M: 'static>(node: &mut Node, name: &str, kind: &str) -> Subscription<M> {
    let name = Name::new("/", name).unwrap();
    let kind = MessageTypeName::new("waferbot_msgs", kind);
    let topic = node.create_topic(&name, kind, &qos()).expect("topic");
    node.create_subscription(&topic, None)
        .expect("subscription")
}
