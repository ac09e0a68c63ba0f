// The part of ros2_control's controller_interface and hardware_interface that the example uses, declared again for
// tests where they are not there: the same names and signatures (Jazzy).
#pragma once
#include <optional>

#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

namespace hardware_interface
{
class LoanedStateInterface
{
public:
  explicit LoanedStateInterface(const double * value) : value_(value) {}
  LoanedStateInterface(const LoanedStateInterface & other) = delete;
  LoanedStateInterface(LoanedStateInterface && other) = default;
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const
  {
    return *value_;
  }

private:
  const double * value_;
};

class LoanedCommandInterface
{
public:
  explicit LoanedCommandInterface(double * value) : value_(value) {}
  LoanedCommandInterface(const LoanedCommandInterface & other) = delete;
  LoanedCommandInterface(LoanedCommandInterface && other) = default;
  template <typename T>
  [[nodiscard]] bool set_value(const T & value, unsigned int = 10)
  {
    *value_ = value;
    return true;
  }

private:
  double * value_;
};
}  // namespace hardware_interface

namespace controller_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };

enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };

struct InterfaceConfiguration
{
  interface_configuration_type type = interface_configuration_type::NONE;
  std::vector<std::string> names = {};
};

class ControllerInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_init() = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  std::shared_ptr<const rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
  unsigned int get_update_rate() const { return update_rate_; }

  template <typename ParameterT>
  auto auto_declare(const std::string & name, const ParameterT & default_value)
  {
    return get_node()->declare_parameter<ParameterT>(name, default_value);
  }

  return_type init(std::map<std::string, rclcpp::Parameter> overrides, unsigned int update_rate)
  {
    node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>(std::move(overrides));
    update_rate_ = update_rate;
    return on_init() == CallbackReturn::SUCCESS ? return_type::OK : return_type::ERROR;
  }

  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && command_interfaces,
    std::vector<hardware_interface::LoanedStateInterface> && state_interfaces)
  {
    command_interfaces_ = std::move(command_interfaces);
    state_interfaces_ = std::move(state_interfaces);
  }

protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
  unsigned int update_rate_ = 0;
};
}  // namespace controller_interface
