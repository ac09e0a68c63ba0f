// What ros2_control's manager does with a controller: loads it from its library, configures and activates it, updates
// it once a period with a simulated UR10, changes parameters while it runs. State and torques go to $TRACE.
#include <dlfcn.h>

#include <cmath>
#include <cstdlib>

#include "controller_interface/controller_interface.hpp"
#include "trajectory_msgs/msg/joint_trajectory_point.hpp"

#include "plant.h"

using controller_interface::CallbackReturn;
using controller_interface::return_type;
using rclcpp::Parameter;
using trajectory_msgs::msg::JointTrajectoryPoint;

#define REQUIRE(condition) \
  if (!(condition)) { \
    std::fprintf(stderr, "line %d: not so: %s\n", __LINE__, #condition); \
    return 1; \
  }

namespace
{
constexpr int JOINTS = sizeof plant_zero.q / sizeof plant_zero.q[0];
const rclcpp_lifecycle::State state;
const std::vector<std::string> names = {"a", "b", "c", "d", "e", "f"};
using Controller = std::unique_ptr<controller_interface::ControllerInterface>;

void send(const Controller & controller, const JointTrajectoryPoint & point)
{
  const auto found = controller->get_node()->subscriptions.at("~/reference").lock();
  std::static_pointer_cast<rclcpp::Subscription<JointTrajectoryPoint>>(found)->callback(point);
}
}  // namespace

int main(int argc, char ** argv)
{
  REQUIRE(argc == 2);
  void * library = dlopen(argv[1], RTLD_NOW);
  REQUIRE(library != nullptr);
  const auto make = reinterpret_cast<controller_interface::ControllerInterface * (*)()>(dlsym(library, "make_plugin"));
  const auto made = [&](std::map<std::string, Parameter> given, unsigned int rate = 1000) {
    Controller controller(make());
    const bool begun = controller->init(std::move(given), rate) == return_type::OK;
    return begun && controller->on_configure(state) == CallbackReturn::SUCCESS ? std::move(controller) : nullptr;
  };
  const auto joints = [&](std::vector<std::string> given) { return Parameter("joints", std::move(given)); };

  // What does not fit the law is refused before the arm moves.
  REQUIRE(!made({{"joints", joints({"a"})}}));
  REQUIRE(!made({{"joints", joints(names)}}, 500));
  REQUIRE(!made({{"joints", joints(names)}, {"law.kp", Parameter("law.kp", std::nan(""))}}));
  REQUIRE(!made({{"joints", joints(names)}, {"law.kp", Parameter("law.kp", std::vector<double>{1.0, 2.0})}}));

  const auto controller = made({{"joints", joints(names)}, {"law.kp", Parameter("law.kp", 120.0)}});
  REQUIRE(controller);
  const auto commanded = controller->command_interface_configuration().names;
  const auto measured = controller->state_interface_configuration().names;
  REQUIRE(commanded.size() == JOINTS && commanded[1] == "b/effort");
  REQUIRE(measured.size() == 2 * JOINTS && measured[1] == "b/position" && measured[JOINTS + 1] == "b/velocity");

  plant_inputs arm = plant_zero;
  plant_memory memory;
  plant_outputs outputs;
  double tau[JOINTS] = {};
  std::vector<hardware_interface::LoanedCommandInterface> commands;
  std::vector<hardware_interface::LoanedStateInterface> states;
  for (int i = 0; i < JOINTS; i++) {
    arm.q[i] = plant_defaults.law.home[i];
    commands.emplace_back(&tau[i]);
    states.emplace_back(&arm.q[i]);
  }
  for (int i = 0; i < JOINTS; i++) {
    states.emplace_back(&arm.v[i]);
  }
  plant_start(&arm, &plant_defaults, &memory);
  controller->assign_interfaces(std::move(commands), std::move(states));
  REQUIRE(controller->on_activate(state) == CallbackReturn::SUCCESS);

  std::FILE * trace = std::fopen(std::getenv("TRACE"), "wb");
  const auto write = [&] {
    for (const double * row : {arm.q, arm.v, tau}) {
      std::fwrite(row, sizeof(double), JOINTS, trace);
    }
  };
  JointTrajectoryPoint point;
  for (int tick = 0; tick < 1000; tick++) {
    if (tick >= 100) {  // a reference in every tick, of which some do not fit and are left out
      const double angle = 0.002 * (tick - 100);
      point.positions.assign(arm.q, arm.q + JOINTS);
      for (int i = 0; i < JOINTS; i++) {
        point.positions[static_cast<std::size_t>(i)] = plant_defaults.law.home[i] + 0.2 * (1.0 - std::cos(angle));
      }
      point.velocities.assign(JOINTS, 0.4 * std::sin(angle));
      point.accelerations.assign(JOINTS, 0.8 * std::cos(angle));
      if (tick % 100 == 50) {
        point.positions[2] = std::nan("");
      } else if (tick % 100 == 60) {
        point.velocities.pop_back();
      }
      send(controller, point);
    }
    if (tick == 500) {
      const auto node = controller->get_node();
      const std::vector<double> com = {0.0, 0.02, 0.1};
      REQUIRE(!node->set_parameters_atomically({Parameter("law.kp", INFINITY)}).successful);
      REQUIRE(!node->set_parameters_atomically({Parameter("limits.tau", std::vector<double>(3, 1.0))}).successful);
      REQUIRE(node->set_parameters_atomically({Parameter("law.kp", 250.0), Parameter("law.kd", 30.0),
        Parameter("model.payload.mass", 1.5), Parameter("model.payload.com", com)}).successful);
    }
    REQUIRE(controller->update(rclcpp::Time(), rclcpp::Duration()) == return_type::OK);
    write();
    for (int i = 0; i < JOINTS; i++) {
      arm.ref.a[i] = tau[i];
    }
    plant_step(&arm, &plant_defaults, &memory, &outputs);
    for (int i = 0; i < JOINTS; i++) {
      arm.v[i] += outputs.command[i] * plant_defaults.dt;
      arm.q[i] += arm.v[i] * plant_defaults.dt;
    }
  }

  // A measurement that is no number: an error, and the torques are those of before.
  const double last = tau[1], velocity = arm.v[1];
  arm.v[1] = std::nan("");
  REQUIRE(controller->update(rclcpp::Time(), rclcpp::Duration()) == return_type::ERROR && tau[1] == last);
  REQUIRE(controller->on_deactivate(state) == CallbackReturn::SUCCESS && tau[1] == 0.0);

  // Then the arm is moved, and a new start holds it where it is.
  arm.v[1] = velocity;
  for (int i = 0; i < JOINTS; i++) {
    arm.q[i] += 0.1;
  }
  REQUIRE(controller->on_activate(state) == CallbackReturn::SUCCESS);
  REQUIRE(controller->update(rclcpp::Time(), rclcpp::Duration()) == return_type::OK);
  write();
  std::fclose(trace);
  return 0;
}
