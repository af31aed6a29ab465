#include "session/instance_rows.hpp"

#include <algorithm>

namespace weft {
namespace {

/// Some rows of a prediction.
class Rows final : public Prediction {
 public:
  Rows(std::unique_ptr<Prediction> all, std::size_t count, std::vector<std::size_t> rows)
      : all_(std::move(all)), count_(count), rows_(std::move(rows)) {
    for (const std::size_t row : rows_) shapes_.push_back(all_->shapes().at(row));
  }
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t i) const override { return all_->failure(rows_.at(i)); }
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    return picked(all_->pullback(spread(cotangents)));
  }
  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    return picked(all_->jvp(spread(directions)));
  }

 private:
  template <class T>
  std::vector<std::vector<T>> spread(const std::vector<std::vector<T>>& per_case) const {
    require_shape("instance rows: cases", per_case.size(), rows_.size());
    std::vector<std::vector<T>> per_row(count_);
    for (std::size_t i = 0; i < rows_.size(); ++i) per_row[rows_[i]] = per_case[i];
    return per_row;
  }
  template <class T>
  std::vector<T> picked(std::vector<T> per_row) const {
    std::vector<T> per_case;
    for (const std::size_t row : rows_) per_case.push_back(std::move(per_row.at(row)));
    return per_case;
  }

  std::unique_ptr<Prediction> all_;
  std::size_t count_;
  std::vector<std::size_t> rows_;  // of each case
  std::vector<std::vector<ShapeDistribution>> shapes_;
};

}  // namespace

std::unique_ptr<Prediction> predict_in_rows(const Predictor& predictor, const std::vector<PredictionCase>& cases,
                                            const std::vector<Index>& instances, Index count,
                                            const PredictionRequest& request) {
  require_shape("instance rows: instances", instances.size(), cases.size());
  if (!std::is_sorted(instances.begin(), instances.end()) ||
      (!instances.empty() && (instances.front() < 0 || instances.back() >= count)))
    throw Error("instance rows: instances must ascend within [0, " + std::to_string(count) + ")");
  if (predictor.capabilities().deterministic || cases.empty()) return predictor.predict(cases, request);

  std::vector<std::size_t> ordinal(cases.size(), 0);  // of each case among the cases of its instance
  for (std::size_t i = 1; i < cases.size(); ++i)
    if (instances[i] == instances[i - 1]) ordinal[i] = ordinal[i - 1] + 1;
  const std::size_t each = *std::max_element(ordinal.begin(), ordinal.end()) + 1;
  PredictionCase padding = cases.front();
  padding.segments.clear();
  std::vector<PredictionCase> batch(each * count, padding);
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    rows.push_back(each * instances[i] + ordinal[i]);
    batch[rows.back()] = cases[i];
  }
  auto all = predictor.predict(batch, request);
  return std::make_unique<Rows>(std::move(all), batch.size(), std::move(rows));
}

}  // namespace weft
