// repeat_dataset FROM TO COPIES: writes a dataset whose examples are those of FROM, again and again under new numbers. Files
// that TO has already stay. It makes large datasets for measurements of reading; what is learned from one says nothing.
#include <cstdio>
#include <cstdlib>

#include "learning/dataset_files.hpp"

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: repeat_dataset FROM TO COPIES\n");
    return 2;
  }
  try {
    weft::Dataset all = weft::load_dataset(argv[1]);
    std::filesystem::create_directories(argv[2]);
    const std::int64_t copies = std::atoll(argv[3]), each = all.header.shard_examples;
    std::int64_t number = 0;
    weft::Shard shard{all.header, {}};
    const auto write = [&](std::int64_t file) {
      const auto path = std::filesystem::path(argv[2]) / weft::shard_name(file);
      if (!std::filesystem::exists(path)) weft::write_shard(path, shard);
      shard.examples.clear();
    };
    for (std::int64_t copy = 0; copy < copies; ++copy) {
      for (weft::Example example : all.examples) {
        example.index = number++;
        shard.examples.push_back(std::move(example));
        if (number % each == 0) write(number / each - 1);
      }
    }
    if (!shard.examples.empty()) write(number / each);
    std::printf("%lld examples\n", static_cast<long long>(number));
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
}
