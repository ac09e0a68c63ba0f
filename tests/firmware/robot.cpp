// An FR3 behind libfranka's interface: it adds gravity itself, its first period is 0, packets get lost, and a torque
// that is not finite or changes by more than 1 N m in a millisecond stops it. What it saw and got goes to $TRACE.
#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include <franka/exception.h>
#include <franka/robot.h>

#include "plant.h"

namespace franka {
namespace {

long number(const char* name) {
  const char* text = std::getenv(name);
  return text ? std::strtol(text, nullptr, 10) : -1;
}

struct Arm {
  plant_inputs inputs = plant_zero;
  plant_memory memory{};
  plant_outputs outputs{};
  RobotState state{};

  Arm() {
    std::copy_n(plant_defaults.law.home, 7, inputs.q);
    plant_start(&inputs, &plant_defaults, &memory);
    state.tau_J_d.fill(2.0);  // of what controlled it before
    measure();
  }
  void measure() {
    plant_step(&inputs, &plant_defaults, &memory, &outputs);  // its memory has the pose of the tool
    std::copy_n(inputs.q, 7, state.q.begin());
    std::copy_n(inputs.v, 7, state.dq.begin());
    state.O_T_EE[15] = 1.0;
    for (std::size_t i = 0; i < 3; i++) {
      state.O_T_EE[12 + i] = memory.law.p[i];
      for (std::size_t j = 0; j < 3; j++) {
        state.O_T_EE[4 * j + i] = memory.law.R[i][j];
      }
    }
  }
  void move(const std::array<double, 7>& tau) {
    std::copy(tau.begin(), tau.end(), inputs.ref.a);
    plant_step(&inputs, &plant_defaults, &memory, &outputs);
    for (std::size_t i = 0; i < 7; i++) {
      inputs.v[i] += outputs.command[i] * plant_defaults.dt;
      inputs.q[i] += inputs.v[i] * plant_defaults.dt;
    }
    state.tau_J_d = tau;
    state.time = Duration(state.time.toMSec() + 1);
    measure();
  }
};

}  // namespace

Robot::Robot(const std::string&, RealtimeConfig, size_t) {}

void Robot::setCollisionBehavior(const std::array<double, 7>&, const std::array<double, 7>&,
                                 const std::array<double, 6>&, const std::array<double, 6>&) {}

void Robot::control(std::function<Torques(const RobotState&, franka::Duration)> control_callback, bool limit_rate,
                    double cutoff_frequency) {
  if (limit_rate || cutoff_frequency < kMaxCutoffFrequency) {
    throw ControlException("this robot has neither libfranka's limit of the rate nor its filter");
  }
  Arm arm;
  std::FILE* trace = std::fopen(std::getenv("TRACE"), "wb");
  uint64_t before = 0;
  const char* reflex = nullptr;
  for (long call = 0; reflex == nullptr; call++) {
    if (call == number("STOP_AT")) {
      std::raise(SIGINT);
    }
    RobotState seen = arm.state;
    if (call == number("BAD_FROM")) {
      seen.dq[3] = std::nan("");
    }
    const Duration period(seen.time.toMSec() - before);
    before = seen.time.toMSec();
    const Torques torques = [&] {
      try {
        return control_callback(seen, period);
      } catch (...) {  // libfranka cancels the motion and passes the exception on
        std::puts("cancelled");
        std::fclose(trace);
        throw;
      }
    }();
    const double seconds = period.toSec();
    std::fwrite(&seconds, sizeof(double), 1, trace);
    std::fwrite(seen.q.data(), sizeof(double), 7, trace);
    std::fwrite(seen.dq.data(), sizeof(double), 7, trace);
    std::fwrite(seen.O_T_EE.data(), sizeof(double), 16, trace);
    std::fwrite(torques.tau_J.data(), sizeof(double), 7, trace);
    for (std::size_t i = 0; i < 7; i++) {
      if (!std::isfinite(torques.tau_J[i])) {
        reflex = "a torque is not finite";
      } else if (std::abs(torques.tau_J[i] - arm.state.tau_J_d[i]) > 1.0) {
        reflex = "controller_torque_discontinuity";
      }
    }
    if (torques.motion_finished) {
      std::puts("finished");
      break;
    }
    const int steps = call % 500 == 499 ? 3 : 1;  // two packets lost: the robot goes on with the last torque
    for (int k = 0; k < steps; k++) {
      arm.move(torques.tau_J);
    }
  }
  std::fclose(trace);
  if (reflex != nullptr) {
    throw ControlException(reflex);
  }
}

}  // namespace franka
