#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "context.hpp"
#include "weft/trainable.hpp"

namespace weft::app {

/// The rank that this process was started as: by `weft train --ranks`, mpirun (Open MPI) or srun (Slurm), or by anything
/// that sets WEFT_RANK and WEFT_RANKS. One rank alone if none of them did.
/// @param model file of the fit; the ranks meet in its folder.
/// @throws ConfigError for variables that are no ranks.
FitRanks ranks_of_process(const std::filesystem::path& model);

/// Starts the ranks of a fit on this machine and waits for them. What rank 0 prints is printed. When one dies, the
/// others end by themselves.
/// @param arguments of this program for each rank. @param cancelled asked for five times a second.
/// @return exit code.
int run_ranks(const Context& context, const std::vector<std::string>& arguments, int ranks,
              const std::function<bool()>& cancelled);

}  // namespace weft::app
