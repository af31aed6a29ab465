#pragma once
#include <filesystem>

#include "meshes/import/import.hpp"

namespace weft {

/// Writes NAME.obj and NAME.yaml into the folder. @param command noted in the YAML.
void write_garment_files(const std::filesystem::path& folder, const std::string& name, const ImportedGarment& garment,
                         const std::string& command);

/// The displacement of a fold in two, before it is tuned: from the middle between the hands to its mirror image beyond
/// the middle of the garment. It runs along x from the outermost vertices of the left side. Other grasps give the
/// direction across the line between the hands, along an axis if that is within 15 degrees.
/// @throws ConfigError when the hands lie at the middle of the garment.
Vec2 fold_in_two(const Mesh& mesh, Index hand_1, Index hand_2, bool along_x);

/// The task file NAME_fold.yaml: the garment, the material space fabric.yaml beside it, the simulator in the loop.
/// @param note a comment about the displacement.
std::string task_text(const std::string& name, const std::vector<std::string>& grasp, const Vec2& displacement,
                      const std::string& note);
/// The experiment file NAME_experiment.yaml: learn to fold it.
std::string experiment_text(const std::string& name);

}  // namespace weft
