// The part of libfranka's headers that the example uses, declared again for tests where libfranka is not there:
// the same names, types and defaults (0.21), nothing else. robot.cpp beside this folder simulates an arm behind it.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <string>

namespace franka {

class Duration {
 public:
  Duration() noexcept = default;
  explicit Duration(uint64_t milliseconds) noexcept : milliseconds_(milliseconds) {}
  double toSec() const noexcept { return static_cast<double>(milliseconds_) / 1000.0; }
  uint64_t toMSec() const noexcept { return milliseconds_; }

 private:
  uint64_t milliseconds_ = 0;
};

struct Finishable {
  bool motion_finished = false;
};

class Torques : public Finishable {
 public:
  Torques(const std::array<double, 7>& torques) noexcept : tau_J(torques) {}
  std::array<double, 7> tau_J{};
};

struct RobotState {
  std::array<double, 16> O_T_EE{};
  std::array<double, 7> tau_J_d{};
  std::array<double, 7> q{};
  std::array<double, 7> dq{};
  Duration time{};
};

enum class RealtimeConfig { kEnforce, kIgnore };

constexpr double kMaxCutoffFrequency = 1000.0;
constexpr double kDefaultCutoffFrequency = 100.0;

class Robot {
 public:
  explicit Robot(const std::string& franka_address,
                 RealtimeConfig realtime_config = RealtimeConfig::kEnforce,
                 size_t log_size = 50);
  void control(std::function<Torques(const RobotState&, franka::Duration)> control_callback,
               bool limit_rate = false,
               double cutoff_frequency = kDefaultCutoffFrequency);
  void setCollisionBehavior(const std::array<double, 7>& lower_torque_thresholds,
                            const std::array<double, 7>& upper_torque_thresholds,
                            const std::array<double, 6>& lower_force_thresholds,
                            const std::array<double, 6>& upper_force_thresholds);
};

}  // namespace franka
