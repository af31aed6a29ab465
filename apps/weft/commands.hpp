#pragma once
#include "context.hpp"

/// Every command adds itself to the program; one or two per file cmd_*.cpp.
namespace weft::app {

void register_run(CLI::App& app, Context& context);
void register_plan(CLI::App& app, Context& context);
void register_estimate(CLI::App& app, Context& context);
void register_simulate(CLI::App& app, Context& context);
void register_displacement(CLI::App& app, Context& context);
void register_garment(CLI::App& app, Context& context);
void register_generate(CLI::App& app, Context& context);
void register_dataset(CLI::App& app, Context& context);
void register_train(CLI::App& app, Context& context);
void register_calibrate(CLI::App& app, Context& context);
void register_learn(CLI::App& app, Context& context);
void register_evaluate(CLI::App& app, Context& context);
void register_ablate(CLI::App& app, Context& context);
void register_benchmark(CLI::App& app, Context& context);
void register_reproduce(CLI::App& app, Context& context);
void register_status(CLI::App& app, Context& context);
void register_cancel(CLI::App& app, Context& context);
void register_export(CLI::App& app, Context& context);
void register_conformance(CLI::App& app, Context& context);
void register_plugins(CLI::App& app, Context& context);
void register_describe(CLI::App& app, Context& context);
void register_new(CLI::App& app, Context& context);
void register_completion(CLI::App& app, Context& context);
void register_worker(CLI::App& app, Context& context);

// Below `weft garment`.
void register_garment_import(CLI::App& garment, Context& context);
void register_garment_fold(CLI::App& garment, Context& context);
void register_garment_lay(CLI::App& garment, Context& context);
void register_garment_show(CLI::App& garment, Context& context);

// Below `weft evaluate`.
void register_evaluate_physics(CLI::App& evaluate, Context& context);
void register_evaluate_prediction(CLI::App& evaluate, Context& context);
void register_evaluate_planning(CLI::App& evaluate, Context& context);
void register_evaluate_estimation(CLI::App& evaluate, Context& context);

}  // namespace weft::app
