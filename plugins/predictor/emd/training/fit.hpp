#pragma once

namespace weft::emd {

struct FitJob;

/// Fits a model to the train split of the job's dataset and keeps the best one on the validation split. Resumes from
/// the job's checkpoint if there is one. @throws what TrainablePredictor::fit throws.
void fit(FitJob& job);

}  // namespace weft::emd
