#pragma once
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "weft/config.hpp"

namespace weft {

/// What a node of a config holds. It never changes.
struct ConfigNode::Data {
  Kind kind = Kind::null;
  std::string text;        // of a scalar
  bool is_quoted = false;  // a scalar that is a string even if it looks like a number
  std::vector<std::pair<std::string, ConfigNode>> entries;
  std::vector<ConfigNode> items;
  std::string file;  // for messages; empty: made by the program
  int line = 0;
  std::filesystem::path folder;
  std::string path;
};

struct ConfigNodeAccess {
  using Data = ConfigNode::Data;
  static ConfigNode make(ConfigNode::Data data) {
    return ConfigNode(std::make_shared<const ConfigNode::Data>(std::move(data)));
  }
  static const ConfigNode::Data& data(const ConfigNode& node) { return *node.data_; }
};

}  // namespace weft
