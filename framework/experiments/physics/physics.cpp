#include "experiments/physics/physics.hpp"

#include <cmath>
#include <cstdio>

#include "sdk/formatted.hpp"

namespace weft {

std::string format_physics_row(const PhysicsRow& r) {
  char line[400];
  std::snprintf(line, sizeof line,
                "%-4s %-15s %-8s %-46s %-22s reference %-10.5g measured %-10.5g error %-9.3g bound %-7.3g %s",
                r.passed ? "ok" : "FAIL", r.test.c_str(), r.variant.c_str(), r.name.c_str(), r.quantity.c_str(),
                r.reference, r.measured, r.error, r.bound, r.note.c_str());
  return line;
}

namespace physics {

PhysicsRow row(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
               double reference, double measured, double error, double bound, std::string note) {
  PhysicsRow r;
  r.test = std::move(test);
  r.variant = variant.name;
  r.name = std::move(name);
  r.quantity = std::move(quantity);
  r.reference = reference;
  r.measured = measured;
  r.error = error;
  r.bound = bound;
  r.passed = error <= bound;
  r.note = std::move(note);
  return r;
}
PhysicsRow relative(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
                    double reference, double measured, double bound, std::string note) {
  return row(std::move(test), variant, std::move(name), std::move(quantity), reference, measured,
             std::abs(measured / reference - 1.0), bound, std::move(note));
}

std::string text(const char* format, double value) { return formatted(format, value); }
std::string mm(double edge) { return text("%g mm", 1e3 * edge); }

}  // namespace physics
}  // namespace weft
