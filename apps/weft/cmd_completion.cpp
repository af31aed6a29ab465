#include <algorithm>

#include "commands.hpp"

namespace weft::app {
namespace {

std::string single_quoted(const std::string& text) {
  std::string quote = "'";
  for (const char c : text) quote += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quote + "'";
}

/// Names as the command line has them: "--out", "-h".
std::vector<std::string> names_of(const CLI::Option& option) {
  std::vector<std::string> names;
  for (const auto& name : option.get_lnames()) names.push_back("--" + name);
  for (const auto& name : option.get_snames()) names.push_back("-" + name);
  return names;
}

/// The values that CLI::IsMember allows, "gltf usd"; empty: any. CLI11 has them only in the text "TEXT:{gltf,usd}".
std::string choices_of(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const auto begin = type.find('{'), end = type.rfind('}');
  if (begin == std::string::npos || end == std::string::npos) return "";
  std::string choices = type.substr(begin + 1, end - begin - 1);
  std::replace(choices.begin(), choices.end(), ',', ' ');
  return choices;
}

/// A `case` of the shells for every command that is shown in --help: what may follow it, and the choices of its options.
/// @param path of the command: "/evaluate/planning"; empty for weft itself.
void add_cases(const CLI::App& command, const std::string& path, std::string& words, std::string& choices) {
  std::string commands, options, values;
  int arguments = 0;
  for (const CLI::Option* option : command.get_options()) {
    if (option->get_group().empty()) continue;  // not for people
    std::vector<std::string> names = names_of(*option);
    if (names.empty()) names = {std::to_string(++arguments)};
    for (const auto& name : names) {
      if (name[0] == '-') options += " " + name;
      if (name[0] == '-' && option->get_items_expected_min() > 0) values += " " + name;
      if (const std::string allowed = choices_of(*option); !allowed.empty())
        choices += "    " + single_quoted(path + " " + name) + ") choices=" + single_quoted(allowed) + " ;;\n";
    }
  }
  const auto below = command.get_subcommands([](const CLI::App* one) { return !one->get_group().empty(); });
  for (const CLI::App* one : below) commands += " " + one->get_name();
  words += "    " + single_quoted(path) + ") below=" + single_quoted(commands + " ") +
           " flags=" + single_quoted(options) + " values=" + single_quoted(values + " ") + " ;;\n";
  for (const CLI::App* one : below) add_cases(*one, path + "/" + one->get_name(), words, choices);
}

/// What both shells share. `_weft_at WORD...` reads the words before the cursor, and sets `expected`, `below`, `flags`
/// and `choices`.
std::string tables(const CLI::App& app) {
  std::string words, choices;
  add_cases(app, "", words, choices);
  return R"(_weft_words() {  # what may follow a command; `values` are the options that a value follows
  below='' flags='' values=''
  case "$1" in
)" + words +
         R"(  esac
}
_weft_choices() {  # the values of an option, or of the argument of this number
  choices=''
  case "$1" in
)" + choices +
         R"(  esac
}
_weft_at() {
  local at='' option='' word count=1
  expected=word
  _weft_words ''
  for word in "$@"; do
    if [[ -n $option && $word == '=' ]]; then
      expected=value
    elif [[ -n $option && $expected == value ]]; then
      expected=word option=''
    elif [[ $word == -* ]]; then
      expected=word option=$word
      if [[ $values == *" $word "* ]]; then expected=value; fi
    elif [[ $below == *" $word "* ]]; then
      at+=/$word option=''
      _weft_words "$at"
    else
      option=''
      count=$((count + 1))
    fi
  done
  if [[ $expected == value ]]; then _weft_choices "$at $option"; else _weft_choices "$at $count"; fi
}
)";
}

constexpr const char* kBash = R"(_weft() {
  local current=${COMP_WORDS[COMP_CWORD]} before=("${COMP_WORDS[@]:1:COMP_CWORD-1}")
  local expected below flags values choices words=''
  if [[ $current == '=' ]]; then before+=('=') current=''; fi
  _weft_at "${before[@]}"
  if [[ $expected == value ]]; then words=$choices
  elif [[ $current == -* ]]; then words=$flags
  elif [[ $below != ' ' ]]; then words=$below
  else words=$choices; fi
  if [[ -n $words ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
  else
    compopt -o filenames 2>/dev/null
    mapfile -t COMPREPLY < <(compgen -f -- "$current")
  fi
}
complete -F _weft weft
)";

constexpr const char* kZsh = R"(_weft() {
  local expected below flags values choices list=''
  _weft_at "${(@)words[2,CURRENT-1]}"
  if [[ $expected == value ]]; then list=$choices
  elif [[ $PREFIX == -* ]]; then list=$flags
  elif [[ $below != ' ' ]]; then list=$below
  else list=$choices; fi
  if [[ -n $list ]]; then compadd -- ${=list}; else _files; fi
}
if [[ $funcstack[1] == _weft ]]; then _weft "$@"; else compdef _weft weft; fi
)";

}  // namespace

void register_completion(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "completion", "Print a script with which a shell completes commands, options and files: source it");
  auto shell = std::make_shared<std::string>();
  command->add_option("shell", *shell, "bash or zsh")->required()->check(CLI::IsMember({"bash", "zsh"}));
  command->callback([&app, &context, shell] {
    context.action = [&app, shell] {
      const bool bash = *shell == "bash";
      Context::output() << (bash ? "# bash completion of weft" : "#compdef weft") << "\n# Made by: weft completion "
                        << *shell << '\n'
                        << tables(app) << (bash ? kBash : kZsh);
      return 0;
    };
  });
}

}  // namespace weft::app
