// The part of libfranka's header that the example uses, declared again for tests; see franka/robot.h.
#pragma once
#include <stdexcept>

namespace franka {
struct Exception : public std::runtime_error {
  using std::runtime_error::runtime_error;
};
struct ControlException : public Exception {
  using Exception::Exception;
};
}  // namespace franka
