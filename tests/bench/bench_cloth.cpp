// The cloth simulator through the default fold of the T-shirt task, released and settled, at several mesh sizes; sheets
// of three fabrics lifted and dropped, coarse and fine; and, where Bullet is installed, its stock position-based soft body on
// the same mesh and path. `weft benchmark` has the frames of other motions and sizes, and folds at once.
// Times are the thread's CPU time unless the name says real_time, so that other programs disturb them little.
#include <benchmark/benchmark.h>

#include <cmath>
#include <map>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "meshes/mesher.hpp"
#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"

#ifdef WEFT_BENCH_BULLET
#include <BulletSoftBody/btDefaultSoftBodySolver.h>
#include <BulletSoftBody/btSoftBody.h>
#include <BulletSoftBody/btSoftBodyHelpers.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <btBulletDynamicsCommon.h>
#endif

namespace {

using namespace weft;

/// The shipped task on a uniform mesh of this edge length, um; 0: on the mesh that ships.
const Task& task_of(std::int64_t edge_um) {
  static std::map<std::int64_t, Task> tasks;
  static const auto registry =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
  static const auto host = make_host(registry, HostOptions{.threads = 1, .checks = PluginChecks::none});
  const auto found = tasks.find(edge_um);
  if (found != tasks.end()) return found->second;
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/tasks/tshirt_fold_network.yaml");
  TaskParams params;
  read_params(ConfigNode::mapping({{"garment", config.at("garment")},
                                   {"material", config.at("material")},
                                   {"manipulation", config.at("manipulation")},
                                   {"trajectory", config.at("trajectory")}}),
              params);
  Task task = make_task(params, config, *host);
  if (edge_um > 0) {
    const GeneratedMesh mesh = generate_mesh(shirt_outline({}), {.edge_m = 1e-6 * static_cast<double>(edge_um)});
    task.garment = std::make_shared<const Garment>(make_garment(mesh.mesh, "tshirt", mesh.vertices));
    for (Index hand = 0; hand < 2; ++hand) {
      const Index vertex = task.garment->vertex(params.manipulation.grasp[hand]);
      task.manipulation.grasp_vertices[hand] = vertex;
      task.manipulation.grasp_points.row(hand).head<2>() = task.garment->positions.row(vertex).head<2>();
    }
  }
  return tasks.emplace(edge_um, std::move(task)).first->second;
}
std::shared_ptr<Simulator> make_simulator() {
  static const auto registry =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
  static const auto host = make_host(registry, HostOptions{.threads = 1, .checks = PluginChecks::none});
  return host->create<Simulator>(ConfigNode::parse("{plugin: cloth}", "bench"));
}

/// Targets of the default arc, frame by frame, to its release.
std::vector<Positions> path_of(const Task& task) {
  std::vector<Positions> targets;
  Vector state = task.trajectory->initial_state(task.manipulation);
  const Controls controls = task.trajectory->default_controls(25);
  for (Index j = 0; j < controls.rows() && !task.trajectory->released(state); ++j) {
    const SegmentPath path = task.trajectory->segment(task.manipulation, state, controls.row(j).transpose());
    targets.insert(targets.end(), path.targets.begin(), path.targets.end());
    state = path.end_state;
  }
  return targets;
}

/// Counters: seconds per frame, over the fold and until it has settled.
void count_frames(benchmark::State& state, Index frames, Index vertices) {
  state.counters["s_per_frame"] =
      benchmark::Counter(static_cast<double>(frames), benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
  state.counters["vertices"] = static_cast<double>(vertices);
}

/// Argument: edge length, um.
void fold(benchmark::State& state) {
  const Task& task = task_of(state.range(0));
  const auto path = path_of(task);
  const auto simulator = make_simulator();
  Index frames = 0;
  for (auto _ : state) {
    state.PauseTiming();
    simulator->reset(task.garment, task.material.at(MaterialProperties::Constant(0.5)), task.scene);
    simulator->grasp(task.manipulation.grasp_vertices);
    state.ResumeTiming();
    for (const Positions& targets : path) simulator->step(targets);
    simulator->release();
    frames += static_cast<Index>(path.size()) + simulator->settle(task.settle).frames;
  }
  count_frames(state, frames, task.garment->vertex_count());
}
BENCHMARK(fold)->Arg(0)->Arg(22000)->Arg(10550)->Arg(5270)->Unit(benchmark::kMillisecond);

/// 300 frames of a sheet of 0.6 m: two corners rise by 0.5 m and near each other within 1.5 s, hang until 3.5 s, drop.
/// Arguments: edge length, mm; fabric.
void sheet(benchmark::State& state) {
  constexpr const char* kFabrics[] = {"basic", "cotton_plain", "denim"};
  const std::string name = kFabrics[state.range(1)];
  const ConfigNode file = ConfigNode::load(WEFT_SOURCE_DIR "/configs/fabrics/" + name + ".yaml");
  const Fabric fabric = read_fabric(file.has("nominal") ? file.at("nominal") : file);
  const double edge = 1e-3 * static_cast<double>(state.range(0));
  const auto side = static_cast<Index>(std::lround(0.6 / edge)) + 1;
  Mesh mesh;
  mesh.source = "sheet";
  mesh.positions.setZero(side * side, 3);
  mesh.faces.resize(2 * (side - 1) * (side - 1), 3);
  for (Index j = 0, f = 0; j < side; ++j)
    for (Index i = 0; i < side; ++i) {
      const int a = static_cast<int>(j * side + i), b = a + 1, c = a + static_cast<int>(side), d = c + 1;
      mesh.positions.row(a) << static_cast<double>(i) * edge, static_cast<double>(j) * edge, 0.0;
      if (i + 1 == side || j + 1 == side) continue;
      mesh.faces.row(f++) << a, b, d;
      mesh.faces.row(f++) << a, d, c;
    }
  mesh.rest = mesh.positions.leftCols(2);
  const auto garment = std::make_shared<const Garment>(make_garment(mesh, "sheet"));
  const auto simulator = make_simulator();
  constexpr Index kUp = 90, kHanging = 210, kFrames = 300;
  Index frames = 0;
  for (auto _ : state) {
    state.PauseTiming();
    simulator->reset(garment, fabric, Scene());
    simulator->grasp(std::vector<Index>{0, side - 1});
    state.ResumeTiming();
    Positions targets(2, 3);
    for (Index k = 0; k < kHanging; ++k) {
      const double part = std::min(1.0, static_cast<double>(k + 1) / static_cast<double>(kUp));
      targets.row(0) << 0.15 * part, 0.0, fabric.thickness_m + 0.5 * part;
      targets.row(1) << 0.6 - 0.15 * part, 0.0, fabric.thickness_m + 0.5 * part;
      simulator->step(targets);
    }
    simulator->release();
    for (Index k = kHanging; k < kFrames; ++k) simulator->step(Positions(0, 3));
    frames += kFrames;
  }
  count_frames(state, frames, garment->vertex_count());
  state.SetLabel(name);
}
BENCHMARK(sheet)->ArgsProduct({{20, 10, 5}, {0, 1, 2}})->Unit(benchmark::kMillisecond);

#ifdef WEFT_BENCH_BULLET
/// btSoftBody as it comes: 4 substeps of 5 iterations, links and bending links, a box as ground, no self-collision.
/// As many frames as the cloth plugin takes.
void bullet(benchmark::State& state) {
  const Task& task = task_of(state.range(0));
  const Garment& garment = *task.garment;
  const auto path = path_of(task);
  Index settle_frames = 0;
  {
    const auto simulator = make_simulator();
    settle_frames =
        simulate_fold(*simulator, task, MaterialProperties::Constant(0.5), task.trajectory->default_controls(25))
            .settle.frames;
  }
  constexpr int kSubsteps = 4, kIterations = 5;
  constexpr btScalar kStep = static_cast<btScalar>(kFrameSeconds) / kSubsteps;
  Index frames = 0;
  double height = 0.0;
  for (auto _ : state) {
    state.PauseTiming();
    btSoftBodyRigidBodyCollisionConfiguration configuration;
    btCollisionDispatcher dispatcher(&configuration);
    btDbvtBroadphase broadphase;
    btSequentialImpulseConstraintSolver solver;
    btSoftRigidDynamicsWorld world(&dispatcher, &broadphase, &solver, &configuration);
    world.setGravity({0, 0, static_cast<btScalar>(-9.81)});
    world.getWorldInfo().m_gravity = {0, 0, static_cast<btScalar>(-9.81)};
    btBoxShape box({5, 5, static_cast<btScalar>(0.5)});
    box.setMargin(static_cast<btScalar>(0.001));
    btTransform below = btTransform::getIdentity();
    below.setOrigin({0, 0, static_cast<btScalar>(-0.5)});
    btRigidBody::btRigidBodyConstructionInfo info(0, nullptr, &box);
    info.m_startWorldTransform = below;
    btRigidBody ground(info);
    world.addRigidBody(&ground);

    std::vector<btVector3> points;
    for (Index i = 0; i < garment.vertex_count(); ++i)
      points.emplace_back(static_cast<btScalar>(garment.positions(i, 0)),
                          static_cast<btScalar>(garment.positions(i, 1)), static_cast<btScalar>(0.002));
    btSoftBody* body = new btSoftBody(&world.getWorldInfo(), static_cast<int>(points.size()), points.data(), nullptr);
    body->m_materials[0]->m_kLST = 1;
    const auto edges = edges_of(garment.faces);
    for (Index e = 0; e < edges.rows(); ++e) body->appendLink(edges(e, 0), edges(e, 1));
    for (Index f = 0; f < garment.face_count(); ++f)
      body->appendFace(garment.faces(f, 0), garment.faces(f, 1), garment.faces(f, 2));
    btSoftBody::Material* bending = body->appendMaterial();
    bending->m_kLST = static_cast<btScalar>(0.003);
    body->generateBendingConstraints(2, bending);
    body->m_cfg.piterations = kIterations;
    body->m_cfg.kDP = static_cast<btScalar>(0.03);
    body->m_cfg.kDF = static_cast<btScalar>(0.5);
    body->m_cfg.collisions = btSoftBody::fCollision::SDF_RS;
    body->getCollisionShape()->setMargin(static_cast<btScalar>(0.002));
    body->setTotalMass(static_cast<btScalar>(0.043), true);
    body->setActivationState(DISABLE_DEACTIVATION);
    world.addSoftBody(body);
    std::vector<btScalar> inverse_mass;
    for (const Index grasp : task.manipulation.grasp_vertices) {
      auto& node = body->m_nodes[static_cast<int>(grasp)];
      inverse_mass.push_back(node.m_im);
      node.m_im = 0;
    }
    body->updateLinkConstants();
    state.ResumeTiming();

    for (const Positions& targets : path)
      for (int k = 0; k < kSubsteps; ++k) {
        for (Index hand = 0; hand < targets.rows(); ++hand) {
          auto& node = body->m_nodes[static_cast<int>(task.manipulation.grasp_vertices[hand])];
          const btVector3 target(static_cast<btScalar>(targets(hand, 0)), static_cast<btScalar>(targets(hand, 1)),
                                 static_cast<btScalar>(targets(hand, 2)));
          node.m_v = (target - node.m_x) / (kStep * static_cast<btScalar>(kSubsteps - k));
        }
        world.stepSimulation(kStep, 0, kStep);
      }
    for (std::size_t hand = 0; hand < inverse_mass.size(); ++hand) {
      auto& node = body->m_nodes[static_cast<int>(task.manipulation.grasp_vertices[hand])];
      node.m_im = inverse_mass[hand];
      node.m_v = {0, 0, 0};
    }
    body->updateLinkConstants();
    for (Index k = 0; k < settle_frames * kSubsteps; ++k) world.stepSimulation(kStep, 0, kStep);
    frames += static_cast<Index>(path.size()) + settle_frames;

    state.PauseTiming();
    height = 0.0;
    for (int i = 0; i < body->m_nodes.size(); ++i)
      height = std::max(height, static_cast<double>(body->m_nodes[i].m_x.z()));
    world.removeSoftBody(body);
    delete body;
    world.removeRigidBody(&ground);
    state.ResumeTiming();
  }
  count_frames(state, frames, garment.vertex_count());
  state.counters["height_m"] = height;  // of the settled fold: that it was folded at all
}
BENCHMARK(bullet)->Arg(0)->Arg(22000)->Unit(benchmark::kMillisecond);
#endif

}  // namespace

BENCHMARK_MAIN();
