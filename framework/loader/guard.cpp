#include "loader/guard.hpp"

#include <exception>
#include <new>
#include <type_traits>

#include "loader/checked.hpp"
#include "sdk/machine_failure.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

/// Marks an exception that names who failed.
struct Named {
  virtual ~Named() = default;
};
template <class Type>
struct NamedError final : Type, Named {
  using Type::Type;
};

/// Runs with(error, type) for the current exception, where `type` is a null pointer to the type to rethrow it as.
/// Exceptions of a plugin's own types become Error, because their types must not outlive the plugin's library.
template <class With>
void as_weft_error(With&& with) {
  try {
    throw;
  } catch (const ReadError& error) {
    with(error.what(), static_cast<ReadError*>(nullptr));
  } catch (const ConfigError& error) {
    with(error.what(), static_cast<ConfigError*>(nullptr));
  } catch (const WriteError& error) {
    with(error.what(), static_cast<WriteError*>(nullptr));
  } catch (const OutOfMemory& error) {
    with(error.what(), static_cast<OutOfMemory*>(nullptr));
  } catch (const std::bad_alloc&) {
    with("there was not enough memory", static_cast<OutOfMemory*>(nullptr));
  } catch (const PluginError& error) {
    with(error.what(), static_cast<PluginError*>(nullptr));
  } catch (const ShapeError& error) {
    with(error.what(), static_cast<ShapeError*>(nullptr));
  } catch (const Unsupported& error) {
    with(error.what(), static_cast<Unsupported*>(nullptr));
  } catch (const Diverged& error) {
    with(error.what(), static_cast<Diverged*>(nullptr));
  } catch (const std::exception& error) {
    with(error.what(), static_cast<Error*>(nullptr));
  } catch (...) {
    with("it threw something that is not a std::exception", static_cast<Error*>(nullptr));
  }
}

[[noreturn]] void rethrow_with(const std::string& where, const std::string& name, bool config_too) {
  try {
    throw;
  } catch (const Named&) {
    throw;
  } catch (...) {
    as_weft_error([&]<class Type>(const char* what, Type*) {
      const bool is_users = !config_too && std::is_base_of_v<ConfigError, Type>;
      std::string text = what;
      if (!is_users && !where.empty()) {
        if (text.starts_with(name + ": ")) text.erase(0, name.size() + 2);
        text.insert(0, where + ": ");
      }
      throw NamedError<Type>(text);
    });
  }
  std::terminate();  // never reached: every branch throws
}

}  // namespace

void rethrow_named(const std::string& name) { rethrow_with(where_text(), name, true); }
void rethrow_named_but_config(const std::string& name) { rethrow_with(where_text(), name, false); }
void rethrow_unblamed() { rethrow_with("", "", true); }

std::string Guard::wrong_result(const std::string& problem) const {
  return where_text() + ": " + problem + "; `weft conformance " + name_ + "` shows what it must be";
}
void Guard::fail(const std::string& problem) const { throw NamedError<WrongResult>(wrong_result(problem)); }
void Guard::fail_not_finite(const std::string& what) const {
  throw NamedError<NotFinite>(wrong_result(what + " is not finite"));
}
void Guard::fail_size(const char* what, Index got, Index wanted) const {
  fail(std::string(what) + " has size " + std::to_string(got) + ", must have " + std::to_string(wanted));
}
void Guard::blame_caller(const std::string& problem) const {
  const std::string where = where_text();
  throw NamedError<ShapeError>((where.empty() ? "weft" : where) + ": gave " + label_ + " " + problem);
}
void Guard::blame_caller_size(const char* what, Index got, Index wanted) const {
  blame_caller(std::string(what) + " of size " + std::to_string(got) + ", must have " + std::to_string(wanted));
}

}  // namespace weft
