#include "session/estimate_corrector.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>

#include "loader/where.hpp"
#include "session/trust_region.hpp"

namespace weft {
namespace {

constexpr Index kThickness = 3, kUnknowns = 5;  // q and b
constexpr double kFloor = 1e-5;                 // m: residual below which a shape is as good as met
constexpr double kGoodResidual = 5e-5;          // m: above, and above the noise, a small step is no reason to stop
constexpr double kRidge = 0.05;                 // of the least-change update, relative
constexpr double kLeastChange = 2e-4;           // of a property; a radius below is none

using Unknowns = Eigen::Matrix<double, kUnknowns, 1>;
using Normal = Eigen::Matrix<double, kUnknowns, kUnknowns>;

}  // namespace

/// The search of one estimate.
class EstimateCorrector::Search {
 public:
  Search(const EstimateCorrector& owner, const EstimateRequest& request) : owner_(owner), request_(request) {
    const Index vertices = owner.task_.garment->vertex_count();
    for (std::size_t k = 0; k < request.observations.size(); ++k) {
      const auto& seen = *request.observations[k];
      Shape shape{static_cast<Index>(k), seen.sigma, {}};
      for (Index v = 0; v < vertices; ++v)
        if (seen.sees(v)) shape.vertices.push_back(v);
      if (!shape.vertices.empty()) shapes_.push_back(std::move(shape));
    }
    start_sigma_ = std::hypot(owner.params_.start_height_sigma_m, request.start_sigma);
    // As in EstimationObjective: only what lies as it was made shows its thickness.
    has_start_ = owner.params_.start_height_sigma_m > 0.0 && !request.start->isZero(0.0) && !owner.task_.start;
    start_height_ = lowest_layer(*owner.task_.garment, *request.start).height;
    bias_sigma_ = std::max(request.start_height_sigma, 1e-9);
  }

  /// A simulated sequence.
  struct Point {
    MaterialProperties q;
    double bias = 0.0;
    std::shared_ptr<const TwinSequence> sim;  // null: it diverged
    std::vector<double> mean_squares;         // [shapes], after the bias
    double loss = std::numeric_limits<double>::infinity();
  };

  bool has_shapes() const { return !shapes_.empty(); }

  /// @param so_far the sequence without its last segments, if it was simulated at q before.
  Point simulate(const MaterialProperties& q, const TwinSequence* so_far = nullptr) {
    ++simulations_;
    Point point;
    point.q = q;
    try {
      const bool goes_on = so_far != nullptr && so_far->goes_on();
      point.sim = std::make_shared<const TwinSequence>(goes_on ? owner_.twin_->longer(*so_far, request_.controls)
                                                               : owner_.twin_->sequence(q, request_.controls));
    } catch (const Diverged&) {
      return point;
    }
    // Few rounds of: the best bias for the scales, the scales for the bias.
    point.mean_squares.assign(shapes_.size(), kFloor * kFloor);
    for (int round = 0; round < 4; ++round) {
      if (round > 0) point.bias = best_bias(point);
      for (std::size_t k = 0; k < shapes_.size(); ++k) point.mean_squares[k] = mean_square(point, k);
    }
    point.loss = loss(point);
    return point;
  }

  /// Whether the sequence is met as well as its noise allows.
  bool is_met(const Point& point) const {
    for (std::size_t k = 0; k < shapes_.size(); ++k) {
      const double n = static_cast<double>(3 * shapes_[k].vertices.size());
      const double noise = shapes_[k].noise * shapes_[k].noise;
      if (point.mean_squares[k] > noise * (1.0 + 4.0 * std::sqrt(2.0 / n)) + kGoodResidual * kGoodResidual)
        return false;
    }
    return true;
  }

  /// d shapes / d q by the network, [shapes] of [3 seen, 4].
  std::vector<Matrix> network_jacobian(const MaterialProperties& q) const {
    std::vector<PredictionCase> cases;
    std::vector<double> spans;
    for (Index p = 0; p < 4; ++p) {
      MaterialProperties low = q, high = q;
      low(p) = std::max(0.0, q(p) - owner_.params_.difference_step);
      high(p) = std::min(1.0, q(p) + owner_.params_.difference_step);
      spans.push_back(high(p) - low(p));
      cases.push_back(make_case(low));
      cases.push_back(make_case(high));
    }
    const auto prediction = owner_.predictor_->predict(cases, {.moments = Moments::mean});
    std::vector<Matrix> jacobian = no_jacobian();
    for (Index p = 0; p < 4; ++p) {
      if (!prediction->failure(2 * p).empty() || !prediction->failure(2 * p + 1).empty()) continue;
      for (std::size_t k = 0; k < shapes_.size(); ++k) {
        const Positions change =
            (prediction->shapes()[2 * p + 1][k].mean - prediction->shapes()[2 * p][k].mean) / spans[p];
        jacobian[k].col(p) = seen_part(change, k);
      }
    }
    return jacobian;
  }

  /// The same by the simulator: four simulations, side by side.
  std::vector<Matrix> simulated_jacobian(const Point& at) {
    std::vector<Point> moved(4);
    std::vector<double> spans(4);
    for (Index p = 0; p < 4; ++p) {
      moved[p].q = at.q;
      spans[p] = at.q(p) > 0.5 ? -owner_.params_.difference_step : owner_.params_.difference_step;
      moved[p].q(p) += spans[p];
    }
    owner_.host_.parallel_for(4, [&](std::int64_t p) {
      Search copy = *this;
      moved[p] = copy.simulate(moved[p].q);
    });
    simulations_ += 4;
    std::vector<Matrix> jacobian = no_jacobian();
    for (Index p = 0; p < 4; ++p) {
      if (!moved[p].sim) continue;
      for (std::size_t k = 0; k < shapes_.size(); ++k)
        jacobian[k].col(p) = seen_part((shape_of(moved[p], k) - shape_of(at, k)) / spans[p], k);
    }
    return jacobian;
  }

  /// Adds the smallest change that makes the Jacobian fit the differences to the other simulated points.
  void fit_differences(const Point& at, const std::vector<Point>& others, std::vector<Matrix>& jacobian) const {
    std::vector<const Point*> usable;
    for (const auto& other : others)
      if (other.sim && (other.q - at.q).norm() > 1e-9) usable.push_back(&other);
    if (usable.empty()) return;
    const Index n = std::ssize(usable);
    Matrix steps(4, n);
    for (Index i = 0; i < n; ++i) steps.col(i) = usable[i]->q - at.q;
    Matrix gram = steps.transpose() * steps;
    gram.diagonal().array() += kRidge * gram.diagonal().minCoeff();
    const Matrix inverse = gram.ldlt().solve(steps.transpose());  // [n, 4]
    for (std::size_t k = 0; k < shapes_.size(); ++k) {
      Matrix differences(jacobian[k].rows(), n);
      for (Index i = 0; i < n; ++i) differences.col(i) = seen_part(shape_of(*usable[i], k) - shape_of(at, k), k);
      jacobian[k] += (differences - jacobian[k] * steps) * inverse;
    }
  }

  /// Gauss-Newton's normal equations of the loss at a point: H (dq, db) = g.
  void normal_equations(const Point& at, const std::vector<Matrix>& jacobian, Normal& h, Unknowns& g) const {
    h.setZero();
    g.setZero();
    const double n = owner_.params_.effective_coordinates;
    for (std::size_t k = 0; k < shapes_.size(); ++k) {
      const Vector residual = residuals(at, k);
      Matrix j(residual.size(), kUnknowns);
      j.leftCols(4) = jacobian[k];
      j.col(4).setZero();
      for (Index i = 2; i < residual.size(); i += 3) j(i, 4) = 1.0;
      const double weight = n / (static_cast<double>(residual.size()) * at.mean_squares[k]);
      h += weight * j.transpose() * j;
      g += weight * j.transpose() * residual;
    }
    if (has_start_) {
      Unknowns slope = Unknowns::Zero();
      slope(kThickness) = thickness_slope(at.q(kThickness));
      slope(4) = 1.0;
      h += slope * slope.transpose() / (start_sigma_ * start_sigma_);
      g += slope * (start_height_ - thickness(at.q(kThickness)) - at.bias) / (start_sigma_ * start_sigma_);
    }
    h(4, 4) += 1.0 / (bias_sigma_ * bias_sigma_);
    g(4) -= at.bias / (bias_sigma_ * bias_sigma_);
    h.topLeftCorner<4, 4>().diagonal().array() += 1e-9 * h.topLeftCorner<4, 4>().trace() + 1e-12;
  }

  /// The step that minimises the quadratic model within the box and the radius, by projected coordinate descent.
  MaterialProperties step(const Point& at, const Normal& h, const Unknowns& g, double radius, double& promised) const {
    Unknowns x = Unknowns::Zero(), low, high;
    for (Index p = 0; p < 4; ++p) {
      low(p) = std::max(-radius, -at.q(p));
      high(p) = std::min(radius, 1.0 - at.q(p));
    }
    low(4) = -std::numeric_limits<double>::infinity();
    high(4) = std::numeric_limits<double>::infinity();
    for (int sweep = 0; sweep < 2000; ++sweep) {
      double largest = 0.0;
      for (Index i = 0; i < kUnknowns; ++i) {
        const double before = x(i);
        const double gradient = g(i) - h.row(i).dot(x);
        x(i) = std::clamp(before + gradient / h(i, i), low(i), high(i));
        largest = std::max(largest, std::abs(x(i) - before) * std::sqrt(h(i, i)));
      }
      if (largest < 1e-9) break;
    }
    promised = g.dot(x) - 0.5 * x.dot(h * x);
    return x.head<4>();
  }

  /// The posterior around the best point, as MaterialPosterior has it.
  MaterialPosterior posterior(const Point& best, const std::vector<Matrix>& jacobian) const {
    const double n = owner_.params_.effective_coordinates;
    const double count = static_cast<double>(shapes_.size());
    const double share = 1.0 / (1.0 + (count - 1.0) * owner_.params_.shape_correlation);
    Eigen::Matrix4d precision = Eigen::Matrix4d::Zero();
    for (std::size_t k = 0; k < shapes_.size(); ++k) {
      const double size = static_cast<double>(jacobian[k].rows());
      const double noise = shapes_[k].noise * shapes_[k].noise;
      // What the noise leaves unexplained moves in blocks of coordinates; the noise averages out in a block.
      const double model = std::max({best.mean_squares[k] - noise, noise * std::sqrt(2.0 / size), kFloor * kFloor});
      const double block = model + noise * n / size;
      precision += share * n / (size * block) * jacobian[k].transpose() * jacobian[k];
    }
    if (has_start_) {
      const double slope = thickness_slope(best.q(kThickness));
      precision(kThickness, kThickness) += slope * slope / (start_sigma_ * start_sigma_ + bias_sigma_ * bias_sigma_);
    }
    precision.diagonal().array() += 1e-6;  // what nothing tells of stays uniform, and the inverse exists
    const Eigen::Matrix4d errors = owner_.model_error_.cwiseAbs2().asDiagonal();
    MaterialPosterior posterior;
    posterior.mode = best.q;
    posterior.precision = (precision.inverse() + errors).inverse();
    return posterior;
  }

  double residual_mm(const Point& point) const {
    double sum = 0.0;
    for (const double square : point.mean_squares) sum += square;
    return 1e3 * std::sqrt(sum / static_cast<double>(shapes_.size()));
  }
  Index simulations() const { return simulations_; }

 private:
  struct Shape {
    Index segment;  // 0-based
    double noise;   // m
    std::vector<Index> vertices;
  };

  PredictionCase make_case(const MaterialProperties& q) const {
    PredictionCase one{
        .shape = std::make_shared<const Positions>(start_at(q)), .previous = nullptr, .state = request_.state};
    one.controls = request_.controls;
    one.knowledge = MaterialKnowledge::certain(q);
    for (const auto& shape : shapes_) one.segments.push_back(shape.segment + 1);
    return one;
  }
  /// A garment that lies as it was made moves with the thickness.
  Positions start_at(const MaterialProperties& q) const {
    if (owner_.task_.start) return *request_.start;
    if (!owner_.task_.scene.obstacles.empty())
      return start_positions(*owner_.task_.garment, owner_.task_.scene, thickness(q(kThickness)));
    const double ground = owner_.task_.scene.ground_height.value_or(0.0);
    return positions_on_ground(*owner_.task_.garment, ground, thickness(q(kThickness)));
  }
  double thickness(double q) const { return owner_.task_.material.ranges[kThickness].at(q); }
  double thickness_slope(double q) const {
    constexpr double h = 1e-5;
    return (thickness(q + h) - thickness(q - h)) / (2.0 * h);
  }
  std::vector<Matrix> no_jacobian() const {
    std::vector<Matrix> jacobian;
    for (const auto& shape : shapes_) jacobian.push_back(Matrix::Zero(3 * std::ssize(shape.vertices), 4));
    return jacobian;
  }
  Vector seen_part(const Positions& field, std::size_t k) const {
    const auto& vertices = shapes_[k].vertices;
    Vector part(3 * std::ssize(vertices));
    for (Index i = 0; i < std::ssize(vertices); ++i) part.segment<3>(3 * i) = field.row(vertices[i]).transpose();
    return part;
  }
  const Positions& shape_of(const Point& point, std::size_t k) const {
    const auto& shapes = point.sim->shapes;
    return shapes[std::min<Index>(shapes_[k].segment, std::ssize(shapes) - 1)];
  }
  /// seen - sim - b e_z.
  Vector residuals(const Point& point, std::size_t k) const {
    Vector r = seen_part(request_.observations[shapes_[k].segment]->positions - shape_of(point, k), k);
    for (Index i = 2; i < r.size(); i += 3) r(i) -= point.bias;
    return r;
  }
  double mean_square(const Point& point, std::size_t k) const {
    const Vector r = residuals(point, k);
    return r.squaredNorm() / static_cast<double>(r.size()) + kFloor * kFloor;
  }
  double best_bias(const Point& point) const {
    double weights = 1.0 / (bias_sigma_ * bias_sigma_), sum = 0.0;
    for (std::size_t k = 0; k < shapes_.size(); ++k) {
      const Vector r = residuals(point, k);
      const double weight =
          owner_.params_.effective_coordinates / (static_cast<double>(r.size()) * point.mean_squares[k]);
      for (Index i = 2; i < r.size(); i += 3) {
        sum += weight * (r(i) + point.bias);
        weights += weight;
      }
    }
    if (has_start_) {
      const double weight = 1.0 / (start_sigma_ * start_sigma_);
      sum += weight * (start_height_ - thickness(point.q(kThickness)));
      weights += weight;
    }
    return sum / weights;
  }
  double loss(const Point& point) const {
    double sum = 0.0;
    for (const double square : point.mean_squares)
      sum += 0.5 * owner_.params_.effective_coordinates * std::log(square / (kFloor * kFloor));
    if (has_start_) {
      const double z = (start_height_ - thickness(point.q(kThickness)) - point.bias) / start_sigma_;
      sum += 0.5 * z * z;
    }
    const double b = point.bias / bias_sigma_;
    return sum + 0.5 * b * b;
  }

  const EstimateCorrector& owner_;
  const EstimateRequest& request_;
  std::vector<Shape> shapes_;
  bool has_start_ = false;
  double start_height_ = 0.0, start_sigma_ = 1.0, bias_sigma_ = 1.0;
  Index simulations_ = 0;
};

EstimateCorrector::EstimateCorrector(const Task& task, std::shared_ptr<const Predictor> predictor,
                                     std::shared_ptr<const Twin> twin, const EstimateCorrectionParams& params,
                                     Host& host)
    : task_(task), predictor_(std::move(predictor)), twin_(std::move(twin)), params_(params), host_(host) {
  const auto read = [](const char* name, const std::vector<double>& list, PropertyVector& to) {
    if (list.empty()) return;
    require_shape(std::string("estimation.correction: ") + name, list.size(), 4);
    to = Eigen::Map<const Eigen::Vector4d>(list.data());
  };
  read("model_error", params.model_error, model_error_);
  read("deviation_scale", params.deviation_scale, deviation_scale_);
}

Estimate EstimateCorrector::first(const EstimateRequest& request, const MaterialProperties& start) const {
  return correct(request, start, nullptr, params_.simulations);
}

Estimate EstimateCorrector::next(const EstimateRequest& request, const Estimate& previous) const {
  return correct(request, *previous.corrected, previous.sequence.get(), params_.later_simulations);
}

Estimate EstimateCorrector::correct(const EstimateRequest& request, const MaterialProperties& start,
                                    const TwinSequence* so_far, Index budget) const {
  const Step segment("segment", request.round + 1);
  const Step correcting("correction of the estimate");
  const auto started = std::chrono::steady_clock::now();
  Estimate estimate;
  Search search(*this, request);
  if (!search.has_shapes()) return estimate;
  std::vector<Search::Point> tried;
  Search::Point best = search.simulate(start, so_far);
  if (!best.sim) throw Diverged("estimation: the simulation at the first estimate diverged");
  double radius = params_.radius;
  std::optional<std::vector<Matrix>> simulated;  // the simulator's own Jacobian
  std::vector<Matrix> jacobian;
  bool is_new = true;
  while (!host_.cancelled()) {
    if (is_new) {
      jacobian = simulated ? *simulated : search.network_jacobian(best.q);
      search.fit_differences(best, tried, jacobian);
      is_new = false;
    }
    if (search.simulations() >= budget) break;
    Normal h;
    Unknowns g;
    search.normal_equations(best, jacobian, h, g);
    double promised = 0.0;
    const MaterialProperties step = search.step(best, h, g, radius, promised);
    const double length = step.cwiseAbs().maxCoeff();
    if (length < params_.least_step || radius < kLeastChange) {
      // A small step is an end only where the sequence is met.
      if (search.is_met(best) || simulated || search.simulations() + 4 >= budget) break;
      simulated = search.simulated_jacobian(best);
      radius = params_.radius;
      is_new = true;
      continue;
    }
    Search::Point next = search.simulate((best.q + step).cwiseMax(0.0).cwiseMin(1.0));
    const double gain = std::isfinite(next.loss) ? (best.loss - next.loss) / promised : -1.0;
    radius = TrustRegion().next(radius, length, gain);
    if (next.loss < best.loss) std::swap(best, next);
    tried.push_back(std::move(next));
    is_new = true;
  }
  if (jacobian.empty()) return estimate;  // cancelled before anything was compared
  estimate.corrected = best.q;
  estimate.sequence = best.sim;
  estimate.posterior = search.posterior(best, jacobian);
  estimate.knowledge = interval_of(estimate.posterior->widened(deviation_scale_));
  estimate.loss = best.loss;
  estimate.residual_mm = search.residual_mm(best);
  estimate.simulations = search.simulations();
  estimate.ended.status = search.is_met(best) ? OptimiserStatus::converged : OptimiserStatus::budget_spent;
  estimate.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return estimate;
}

}  // namespace weft
