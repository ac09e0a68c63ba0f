// A law of taut in libfranka's torque control: an impedance at the tool, which follows a circle until Ctrl-C.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstddef>
#include <iostream>
#include <stdexcept>

#include <franka/exception.h>
#include <franka/robot.h>

#include "fr3.h"

namespace {

std::atomic<bool> stop_asked{false};

class ImpedanceOnCircle {
 public:
  // libfranka calls it once a period: 0 s long in the first call, longer than 1 ms where packets were lost.
  franka::Torques operator()(const franka::RobotState& state, franka::Duration period) {
    std::copy(state.q.begin(), state.q.end(), inputs_.q);
    std::copy(state.dq.begin(), state.dq.end(), inputs_.v);
    inputs_.t += period.toSec();
    if (!started_) {
      start_pose_ = state.O_T_EE;
      inputs_.held.known = 1.0;  // the limits of the torque's rate begin at what the robot commands now
      std::copy(state.tau_J_d.begin(), state.tau_J_d.end(), inputs_.held.tau_applied);
    }
    const bool finished = set_reference(period.toSec());
    if (!started_) {
      fr3_start(&inputs_, &parameters_, &memory_);
      started_ = true;
    }
    if (fr3_step(&inputs_, &parameters_, &memory_, &outputs_) != fr3_OK) {
      throw std::runtime_error("a number of the state or of the torque is not finite");  // libfranka stops the robot
    }
    std::array<double, 7> tau{};
    std::copy_n(outputs_.command, tau.size(), tau.begin());
    franka::Torques torques(tau);
    torques.motion_finished = finished;
    return torques;
  }

  fr3_parameters& parameters() { return parameters_; }

 private:
  // A circle in the plane of y and z; its speed rises and, where a stop is asked for, falls. True half a second later.
  bool set_reference(double dt) {
    constexpr double radius = 0.05, speed = 0.15, acceleration = 0.3;  // [m], [m/s], [m/s^2]
    const double target = stop_asked ? 0.0 : speed / radius, step = acceleration / radius * dt;
    const double change = std::clamp(target - rate_, -step, step);
    rate_ += change;
    angle_ += rate_ * dt;
    rest_ = stop_asked && rate_ == 0.0 ? rest_ + dt : 0.0;

    const double s = std::sin(angle_), c = std::cos(angle_), alpha = dt > 0.0 ? change / dt : 0.0;
    auto& ref = inputs_.ref;
    for (std::size_t i = 0; i < 3; i++) {
      ref.p[i] = start_pose_[12 + i];
      for (std::size_t j = 0; j < 3; j++) {
        ref.R[i][j] = start_pose_[4 * j + i];  // libfranka's matrices stand by columns
      }
    }
    ref.p[1] += radius * (1.0 - c);
    ref.p[2] += radius * s;
    ref.twist[1] = radius * rate_ * s;
    ref.twist[2] = radius * rate_ * c;
    ref.acceleration[1] = radius * (alpha * s + rate_ * rate_ * c);
    ref.acceleration[2] = radius * (alpha * c - rate_ * rate_ * s);
    return rest_ > 0.5;
  }

  fr3_parameters parameters_ = fr3_defaults;  // as they were in Python
  fr3_inputs inputs_ = fr3_zero;
  fr3_memory memory_{};
  fr3_outputs outputs_{};
  std::array<double, 16> start_pose_{};
  bool started_ = false;
  double angle_ = 0.0, rate_ = 0.0, rest_ = 0.0;  // [rad], [rad/s], [s]
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: torque_control ADDRESS\n";
    return 2;
  }
  std::signal(SIGINT, [](int) { stop_asked = true; });
  try {
    franka::Robot robot(argv[1]);
    robot.setCollisionBehavior({{20, 20, 20, 20, 10, 10, 10}}, {{40, 40, 40, 40, 12, 12, 12}},  // [N m]
                               {{20, 20, 20, 20, 20, 20}}, {{40, 40, 40, 40, 40, 40}});         // [N, N m]
    ImpedanceOnCircle law;
    law.parameters().law.K[0] = 300.0;  // "law.K", along x [N/m]
    // Neither libfranka's limit of the rate nor its filter: the law has limits, and has to know what is commanded.
    robot.control([&law](const franka::RobotState& state, franka::Duration period) { return law(state, period); },
                  false, franka::kMaxCutoffFrequency);
  } catch (const std::exception& error) {  // franka::Exception too
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
