// The part of rclcpp that the example uses, declared again for tests where ROS 2 is not there: the same names and
// signatures (Jazzy), and as much behaviour as the controller sees.
#pragma once
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "rcl_interfaces/msg/set_parameters_result.hpp"

#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__), std::fputc('\n', stderr))
#define RCLCPP_WARN(logger, ...) RCLCPP_ERROR(logger, __VA_ARGS__)

namespace rclcpp
{
class Logger {};
class Time {};
class Duration {};
class QoS {};
class SystemDefaultsQoS : public QoS {};

enum class ParameterType : uint8_t {
  PARAMETER_DOUBLE = 3,
  PARAMETER_DOUBLE_ARRAY = 8,
  PARAMETER_STRING_ARRAY = 9,
};

class Parameter
{
public:
  using Value = std::variant<double, std::vector<double>, std::vector<std::string>>;
  Parameter() = default;
  Parameter(std::string name, Value value) : name_(std::move(name)), value_(std::move(value)) {}
  const std::string & get_name() const { return name_; }
  ParameterType get_type() const
  {
    constexpr ParameterType types[] = {
      ParameterType::PARAMETER_DOUBLE, ParameterType::PARAMETER_DOUBLE_ARRAY, ParameterType::PARAMETER_STRING_ARRAY};
    return types[value_.index()];
  }
  double as_double() const { return std::get<double>(value_); }
  std::vector<double> as_double_array() const { return std::get<std::vector<double>>(value_); }
  std::vector<std::string> as_string_array() const { return std::get<std::vector<std::string>>(value_); }

private:
  std::string name_;
  Value value_;
};

namespace node_interfaces
{
struct OnSetParametersCallbackHandle
{
  using SharedPtr = std::shared_ptr<OnSetParametersCallbackHandle>;
  using OnSetParametersCallbackType =
    std::function<rcl_interfaces::msg::SetParametersResult(const std::vector<rclcpp::Parameter> &)>;
  OnSetParametersCallbackType callback;
};

struct PostSetParametersCallbackHandle
{
  using SharedPtr = std::shared_ptr<PostSetParametersCallbackHandle>;
  using PostSetParametersCallbackType = std::function<void(const std::vector<rclcpp::Parameter> &)>;
  PostSetParametersCallbackType callback;
};
}  // namespace node_interfaces

class SubscriptionBase
{
public:
  virtual ~SubscriptionBase() = default;
};

template <typename MessageT>
class Subscription : public SubscriptionBase
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
  std::function<void(const MessageT &)> callback;
};
}  // namespace rclcpp
