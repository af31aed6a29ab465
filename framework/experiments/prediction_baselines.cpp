#include "experiments/prediction_baselines.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>

namespace weft {
namespace {

/// The features that lookup and linear model may use: the material, and the path of the hands by progress.
Vector describe_example(const Example& e, const Trajectory& trajectory) {
  constexpr Index kPoints = 6;
  const Index s = e.states.cols();
  Vector features(4 + kPoints * s + 1);
  features.head<4>() = e.q;
  std::vector<double> progress;
  for (Index j = 0; j <= e.segments(); ++j) progress.push_back(trajectory.progress(e.states.row(j).transpose()));
  Index at = 0;
  for (Index p = 0; p < kPoints; ++p) {
    const double wanted = progress.back() * static_cast<double>(p + 1) / static_cast<double>(kPoints);
    while (at + 1 < e.segments() && progress[at + 1] < wanted) ++at;
    const double a = progress[at], b = progress[at + 1];
    const double t = b > a ? std::clamp((wanted - a) / (b - a), 0.0, 1.0) : 1.0;
    features.segment(4 + p * s, s) = ((1.0 - t) * e.states.row(at) + t * e.states.row(at + 1)).transpose();
  }
  features(features.size() - 1) = static_cast<double>(e.segments());
  return features;
}

}  // namespace

std::map<std::string, PredictionFigures> measure_baselines(const Dataset& dataset, const std::vector<std::size_t>& test,
                                                           const Trajectory& trajectory, Index components, bool learn) {
  std::vector<std::size_t> train;
  for (const auto i : dataset.select(Split::train)) {
    if (learn && dataset.examples[i].released) train.push_back(i);
  }
  std::map<std::string, PredictionTally> tallies;
  const auto settled = [&](std::size_t i) { return dataset.shape(i, dataset.examples[i].segments()); };
  for (const auto i : test) {
    const auto& e = dataset.examples[i];
    tallies["persistence"].add(i, dataset.shape(i, e.segments() - 1), settled(i), 1);
    tallies["start_shape"].add(i, dataset.shape(i, 0), settled(i), e.segments());
  }
  std::map<std::string, PredictionFigures> figures;
  if (train.size() >= 2) {
    const Index n = dataset.header.vertices * 3;
    const auto m = static_cast<Index>(train.size());
    Eigen::MatrixXf shapes(n, m);
    std::vector<Vector> features;
    for (Index k = 0; k < m; ++k) {
      const Positions shape = settled(train[k]);
      shapes.col(k) = Eigen::Map<const Vector>(shape.data(), n).cast<float>();
      features.push_back(describe_example(dataset.examples[train[k]], trajectory));
    }
    const Index f = features.front().size();
    Vector mean = Vector::Zero(f), sd = Vector::Zero(f);
    for (const auto& x : features) mean += x / static_cast<double>(m);
    for (const auto& x : features) sd += (x - mean).cwiseAbs2() / static_cast<double>(m);
    sd = sd.cwiseSqrt().cwiseMax(1e-9);
    // Linear model: ridge regression from the features to the principal components of the settled shapes.
    const Eigen::VectorXf centre = shapes.rowwise().mean();
    const Index some = std::min<Index>(m, 1000);
    Eigen::MatrixXf sample(n, some);
    for (Index k = 0; k < some; ++k) sample.col(k) = shapes.col(k * m / some) - centre;
    const Eigen::SelfAdjointEigenSolver<Matrix> gram((sample.transpose() * sample).cast<double>());
    const Index rank = std::min(components, some - 1);
    Eigen::MatrixXf basis(n, rank);
    for (Index c = 0; c < rank; ++c) {
      basis.col(c) = sample * gram.eigenvectors().col(some - 1 - c).cast<float>();
      basis.col(c).normalize();
    }
    const Matrix codes = (basis.transpose() * (shapes.colwise() - centre)).cast<double>();
    Matrix design(m, f + 1);
    for (Index k = 0; k < m; ++k) {
      design.row(k).head(f) = (features[k] - mean).cwiseQuotient(sd).transpose();
      design(k, f) = 1.0;
    }
    Matrix normal = design.transpose() * design;
    normal.diagonal().array() += 1e-3 * static_cast<double>(m);
    const Matrix weights = normal.ldlt().solve(design.transpose() * codes.transpose());
    const auto positions = [&](const Eigen::VectorXf& flat) {
      const Vector wide = flat.cast<double>();
      return Positions(Eigen::Map<const Positions>(wide.data(), n / 3, 3));
    };
    for (const auto i : test) {
      const auto& e = dataset.examples[i];
      const Positions truth = settled(i);
      const Index k = e.segments();
      tallies["mean_shape"].add(i, positions(centre), truth, k);
      Vector x(f + 1);
      x.head(f) = (describe_example(e, trajectory) - mean).cwiseQuotient(sd);
      x(f) = 1.0;
      tallies["linear_pca"].add(i, positions(centre + basis * (weights.transpose() * x).cast<float>()), truth, k);
      Index nearest_inputs = 0, nearest_shape = 0;
      (design.rowwise() - x.transpose()).rowwise().squaredNorm().minCoeff(&nearest_inputs);
      const Eigen::VectorXf flat = Eigen::Map<const Vector>(truth.data(), n).cast<float>();
      (shapes.colwise() - flat).colwise().squaredNorm().minCoeff(&nearest_shape);
      tallies["nearest_example"].add(i, positions(shapes.col(nearest_inputs)), truth, k);
      tallies["nearest_example_oracle"].add(i, positions(shapes.col(nearest_shape)), truth, k);
    }
  }
  for (const auto& [name, tally] : tallies) figures[name] = tally.figures();
  return figures;
}

}  // namespace weft
