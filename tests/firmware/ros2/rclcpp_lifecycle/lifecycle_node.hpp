// The part of rclcpp_lifecycle's node that the example uses; a subscription is found again under its topic.
#pragma once
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"

namespace rclcpp_lifecycle
{
namespace node_interfaces
{
struct LifecycleNodeInterface
{
  enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
  virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
  virtual ~LifecycleNodeInterface() = default;
};
}  // namespace node_interfaces

class LifecycleNode
{
public:
  explicit LifecycleNode(std::map<std::string, rclcpp::Parameter> overrides) : overrides_(std::move(overrides)) {}

  rclcpp::Logger get_logger() const { return {}; }
  bool has_parameter(const std::string & name) const { return parameters_.count(name) > 0; }
  rclcpp::Parameter get_parameter(const std::string & name) const { return parameters_.at(name); }

  template <typename ParameterT>
  ParameterT declare_parameter(const std::string & name, const ParameterT & default_value)
  {
    rclcpp::Parameter parameter(name, default_value);
    const auto found = overrides_.find(name);
    if (found != overrides_.end()) {
      if (found->second.get_type() != parameter.get_type()) {
        throw std::runtime_error("parameter '" + name + "' has invalid type");
      }
      parameter = found->second;
    }
    parameters_[name] = parameter;
    return default_value;
  }

  rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr add_on_set_parameters_callback(
    rclcpp::node_interfaces::OnSetParametersCallbackHandle::OnSetParametersCallbackType callback)
  {
    auto handle = std::make_shared<rclcpp::node_interfaces::OnSetParametersCallbackHandle>();
    handle->callback = std::move(callback);
    on_set_ = handle;
    return handle;
  }

  rclcpp::node_interfaces::PostSetParametersCallbackHandle::SharedPtr add_post_set_parameters_callback(
    rclcpp::node_interfaces::PostSetParametersCallbackHandle::PostSetParametersCallbackType callback)
  {
    auto handle = std::make_shared<rclcpp::node_interfaces::PostSetParametersCallbackHandle>();
    handle->callback = std::move(callback);
    post_set_ = handle;
    return handle;
  }

  rcl_interfaces::msg::SetParametersResult set_parameters_atomically(const std::vector<rclcpp::Parameter> & parameters)
  {
    rcl_interfaces::msg::SetParametersResult result;
    result.successful = true;
    if (const auto handle = on_set_.lock()) {
      result = handle->callback(parameters);
    }
    if (result.successful) {
      for (const auto & parameter : parameters) {
        parameters_.at(parameter.get_name()) = parameter;
      }
      if (const auto handle = post_set_.lock()) {
        handle->callback(parameters);
      }
    }
    return result;
  }

  template <typename MessageT, typename CallbackT>
  std::shared_ptr<rclcpp::Subscription<MessageT>> create_subscription(
    const std::string & topic_name, const rclcpp::QoS &, CallbackT && callback)
  {
    auto subscription = std::make_shared<rclcpp::Subscription<MessageT>>();
    subscription->callback = std::forward<CallbackT>(callback);
    subscriptions[topic_name] = subscription;
    return subscription;
  }

  std::map<std::string, std::weak_ptr<rclcpp::SubscriptionBase>> subscriptions;

private:
  std::map<std::string, rclcpp::Parameter> overrides_, parameters_;
  std::weak_ptr<rclcpp::node_interfaces::OnSetParametersCallbackHandle> on_set_;
  std::weak_ptr<rclcpp::node_interfaces::PostSetParametersCallbackHandle> post_set_;
};
}  // namespace rclcpp_lifecycle
