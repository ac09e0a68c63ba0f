// A joint-space law exported by taut as a controller of ros2_control: torques from positions and velocities.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <exception>
#include <mutex>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rcl_interfaces/msg/set_parameters_result.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "trajectory_msgs/msg/joint_trajectory_point.hpp"

#include "law.h"

namespace taut_controller
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::return_type;
using trajectory_msgs::msg::JointTrajectoryPoint;

constexpr std::size_t JOINTS = sizeof law_zero.q / sizeof law_zero.q[0];

struct Row  // a parameter of the law
{
  const char * path;
  std::size_t offset, count;
};
#define ROW(path, member, count) {path, offsetof(law_parameters, member), count},
constexpr Row ROWS[] = {law_PARAMETERS(ROW)};

double * numbers(law_parameters & parameters, const Row & row)
{
  return reinterpret_cast<double *>(reinterpret_cast<char *>(&parameters) + row.offset);
}

bool all_finite(const std::vector<double> & values)
{
  return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

std::vector<double> values_of(const rclcpp::Parameter & parameter)
{
  const bool one = parameter.get_type() == rclcpp::ParameterType::PARAMETER_DOUBLE;
  return one ? std::vector<double>{parameter.as_double()} : parameter.as_double_array();
}

class TautController : public controller_interface::ControllerInterface
{
public:
  // The law's parameters under taut's paths, "law.kp", as they were in Python unless a file says otherwise.
  CallbackReturn on_init() override
  {
    try {
      auto_declare<std::vector<std::string>>("joints", {});
      for (const Row & row : ROWS) {
        const double * x = numbers(wanted_, row);
        if (row.path == std::string("dt")) {
          continue;
        }
        if (row.count == 1) {
          auto_declare<double>(row.path, *x);
        } else {
          auto_declare<std::vector<double>>(row.path, std::vector<double>(x, x + row.count));
        }
      }
    } catch (const std::exception & error) {
      RCLCPP_ERROR(get_node()->get_logger(), "%s", error.what());
      return CallbackReturn::ERROR;
    }
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override { return named({"effort"}); }

  InterfaceConfiguration state_interface_configuration() const override { return named({"position", "velocity"}); }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    const auto node = get_node();
    joints_ = node->get_parameter("joints").as_string_array();
    if (joints_.size() != JOINTS) {
      RCLCPP_ERROR(node->get_logger(), "the law has %zu joints; got %zu in 'joints'", JOINTS, joints_.size());
      return CallbackReturn::ERROR;
    }
    if (std::abs(get_update_rate() * law_defaults.dt - 1.0) > 1e-6) {
      RCLCPP_ERROR(
        node->get_logger(), "the law was exported for %g Hz; update_rate is %u", 1.0 / law_defaults.dt,
        get_update_rate());
      return CallbackReturn::ERROR;
    }
    std::vector<rclcpp::Parameter> given;
    for (const Row & row : ROWS) {
      if (node->has_parameter(row.path)) {
        given.push_back(node->get_parameter(row.path));
      }
    }
    const auto result = checked(given);
    if (!result.successful) {
      RCLCPP_ERROR(node->get_logger(), "%s", result.reason.c_str());
      return CallbackReturn::ERROR;
    }
    take(given);
    parameters_ = wanted_;
    on_set_ = node->add_on_set_parameters_callback(
      [this](const std::vector<rclcpp::Parameter> & changed) { return checked(changed); });
    post_set_ = node->add_post_set_parameters_callback(
      [this](const std::vector<rclcpp::Parameter> & changed) { take(changed); });
    subscription_ = node->create_subscription<JointTrajectoryPoint>(
      "~/reference", rclcpp::SystemDefaultsQoS(), [this](const JointTrajectoryPoint & point) { follow(point); });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    fresh_reference_ = false;
    begun_ = false;
    return CallbackReturn::SUCCESS;
  }

  // Without a controller the arm needs brakes, or hardware that holds it: its torques are zero.
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    for (auto & command : command_interfaces_) {
      (void)command.set_value(0.0);
    }
    return CallbackReturn::SUCCESS;
  }

  // Nothing here waits or allocates. After an ERROR the controller manager deactivates the controller.
  return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    for (std::size_t i = 0; i < JOINTS; i++) {
      const auto q = state_interfaces_[i].get_optional(), v = state_interfaces_[JOINTS + i].get_optional();
      if (!q || !v) {
        return return_type::ERROR;
      }
      inputs_.q[i] = *q;
      inputs_.v[i] = *v;
    }
    if (!begun_) {  // hold this pose until a reference comes
      inputs_.t = 0.0;
      inputs_.ref = law_zero.ref;
      std::copy_n(inputs_.q, JOINTS, inputs_.ref.q);
    }
    law_parameters old = parameters_;
    bool changed = false;
    {
      const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
      if (lock && fresh_reference_) {
        inputs_.ref = reference_;
        fresh_reference_ = false;
      }
      if (lock && fresh_parameters_) {
        parameters_ = wanted_;
        fresh_parameters_ = false;
        changed = true;
      }
    }
    if (!begun_) {
      law_start(&inputs_, &parameters_, &memory_);
      begun_ = true;
    } else if (changed) {  // where the law has Limits(blend=): without, leave this line out
      law_change(&inputs_, &parameters_, &old, &memory_);
    }
    if (law_step(&inputs_, &parameters_, &memory_, &outputs_) != law_OK) {
      return return_type::ERROR;
    }
    inputs_.t += parameters_.dt;
    bool written = true;
    for (std::size_t i = 0; i < JOINTS; i++) {
      written = command_interfaces_[i].set_value(outputs_.command[i]) && written;
    }
    return written ? return_type::OK : return_type::ERROR;
  }

private:
  InterfaceConfiguration named(const std::vector<std::string> & interfaces) const
  {
    InterfaceConfiguration out{controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto & interface : interfaces) {
      for (const auto & joint : joints_) {
        out.names.push_back(joint + "/" + interface);
      }
    }
    return out;
  }

  rcl_interfaces::msg::SetParametersResult checked(const std::vector<rclcpp::Parameter> & parameters) const
  {
    rcl_interfaces::msg::SetParametersResult result;
    result.successful = true;
    for (const auto & parameter : parameters) {
      for (const Row & row : ROWS) {
        if (parameter.get_name() == row.path) {
          const auto values = values_of(parameter);
          if (values.size() != row.count || !all_finite(values)) {
            result.successful = false;
            result.reason = parameter.get_name() + " must be " + std::to_string(row.count) + " finite numbers";
          }
        }
      }
    }
    return result;
  }

  void take(const std::vector<rclcpp::Parameter> & parameters)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const auto & parameter : parameters) {
      for (const Row & row : ROWS) {
        if (parameter.get_name() == row.path) {
          const auto values = values_of(parameter);
          std::copy(values.begin(), values.end(), numbers(wanted_, row));
          fresh_parameters_ = true;
        }
      }
    }
  }

  void follow(const JointTrajectoryPoint & point)
  {
    const auto fits = [](const std::vector<double> & x) { return x.size() == JOINTS && all_finite(x); };
    const auto may = [&](const std::vector<double> & x) { return x.empty() || fits(x); };
    if (!fits(point.positions) || !may(point.velocities) || !may(point.accelerations)) {
      RCLCPP_WARN(get_node()->get_logger(), "a reference without %zu finite numbers is left out", JOINTS);
      return;
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    reference_ = law_zero.ref;
    std::copy(point.positions.begin(), point.positions.end(), reference_.q);
    std::copy(point.velocities.begin(), point.velocities.end(), reference_.v);
    std::copy(point.accelerations.begin(), point.accelerations.end(), reference_.a);
    fresh_reference_ = true;
  }

  std::vector<std::string> joints_;
  law_inputs inputs_ = law_zero;
  law_parameters parameters_ = law_defaults;
  law_memory memory_{};
  law_outputs outputs_{};
  bool begun_ = false;

  std::mutex mutex_;  // of what follows, which other threads write; update() only tries it
  law_parameters wanted_ = law_defaults;
  decltype(law_inputs::ref) reference_ = law_zero.ref;
  bool fresh_parameters_ = false, fresh_reference_ = false;

  rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr on_set_;
  rclcpp::node_interfaces::PostSetParametersCallbackHandle::SharedPtr post_set_;
  rclcpp::Subscription<JointTrajectoryPoint>::SharedPtr subscription_;
};
}  // namespace taut_controller

PLUGINLIB_EXPORT_CLASS(taut_controller::TautController, controller_interface::ControllerInterface)
