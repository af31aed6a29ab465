#include "sdk/yaml_limits.hpp"

#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <limits>
#include <sstream>

namespace weft {
namespace {

using Fail = std::function<void(const YAML::Mark* mark, const std::string& message)>;

class ValueCounter final : public YAML::EventHandler {
 public:
  ValueCounter(std::size_t most, const Fail& fail) : most_(most), fail_(fail) {}
  void OnDocumentStart(const YAML::Mark& mark) override { count(mark); }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t) override { count(mark); }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override { count(mark); }
  void OnScalar(const YAML::Mark& mark, const std::string&, YAML::anchor_t, const std::string&) override {
    count(mark);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {
    count(mark);
  }
  void OnSequenceEnd() override {}
  void OnMapStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {
    count(mark);
  }
  void OnMapEnd() override {}

 private:
  void count(const YAML::Mark& mark) {
    if (++values_ <= 2 * most_) return;  // keys count as well
    fail_(&mark, "holds more than " + std::to_string(most_) + " values");
  }
  std::size_t most_;
  const Fail& fail_;
  std::size_t values_ = 0;
};

}  // namespace

void limit_yaml(std::string_view text, std::size_t most, const Fail& fail) {
  if (text.size() <= most) return;  // less text cannot hold more values
  // yaml-cpp keeps all open brackets, which may begin a key, before it reports the first.
  const auto brackets = std::count_if(text.begin(), text.end(), [](char c) { return c == '[' || c == '{'; });
  if (static_cast<std::size_t>(brackets) > most) fail(nullptr, "holds more than " + std::to_string(most) + " brackets");
  ValueCounter counter(most, fail);
  std::istringstream stream{std::string(text)};
  YAML::Parser parser(stream);
  while (parser.HandleNextDocument(counter)) {
  }
}

int yaml_documents(std::string_view text) {
  const Fail never;
  ValueCounter ignored(std::numeric_limits<std::size_t>::max() / 2, never);
  std::istringstream stream{std::string(text)};
  YAML::Parser parser(stream);
  int documents = 0;
  while (documents < 2 && parser.HandleNextDocument(ignored)) ++documents;
  return documents;
}

}  // namespace weft
