#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "loader/checked.hpp"
#include "loader/processors.hpp"
#include "loader/program_host.hpp"
#include "loader/where.hpp"
#include "processes/crash_report.hpp"

namespace weft {

namespace {

/// A fixed set of threads that share the iterations of one parallel_for at a time.
class ThreadPool {
 public:
  explicit ThreadPool(int threads) {
    for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
  }
  ~ThreadPool() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    wake_.notify_all();
    for (auto& worker : workers_) worker.join();
  }

  void run(std::int64_t count, const std::function<void(std::int64_t)>& body) {
    Loop loop{count, &body, Where::here()};
    // Nested or concurrent loops run on their caller's thread. This avoids deadlock, and the outer loop already keeps
    // the threads busy. (inside_ is checked first, since a nested caller may hold busy_ itself.)
    std::unique_lock<std::mutex> busy;
    if (!inside_ && !workers_.empty() && count > 1) busy = std::unique_lock(busy_, std::try_to_lock);
    if (!busy.owns_lock()) {
      share(loop);
      if (loop.error) std::rethrow_exception(loop.error);
      return;
    }
    {
      const std::lock_guard lock(mutex_);
      loop_ = &loop;
      ++generation_;
    }
    wake_.notify_all();
    share(loop);
    std::unique_lock lock(mutex_);
    loop_ = nullptr;
    done_.wait(lock, [&] { return active_ == 0; });
    if (loop.error) std::rethrow_exception(loop.error);
  }

 private:
  struct Loop {
    std::int64_t count;
    const std::function<void(std::int64_t)>* body;
    const Where* caller;
    std::atomic<std::int64_t> next{0};
    std::mutex mutex{};
    std::int64_t failed = -1;
    std::exception_ptr error{};
  };

  // Every iteration runs even after one failed, so that the reported error does not depend on timing.
  static void share(Loop& loop) {
    const bool was_inside = inside_;
    inside_ = true;
    const OnBehalfOf caller(loop.caller);
    for (std::int64_t i = loop.next++; i < loop.count; i = loop.next++) {
      try {
        (*loop.body)(i);
      } catch (...) {
        const std::lock_guard lock(loop.mutex);
        if (loop.failed < 0 || i < loop.failed) {
          loop.failed = i;
          loop.error = std::current_exception();
        }
      }
    }
    inside_ = was_inside;
  }

  void work() {
    const CrashStack crash_stack;
    std::uint64_t seen = 0;
    for (;;) {
      Loop* loop = nullptr;
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [&] { return stopping_ || (loop_ != nullptr && generation_ != seen); });
        if (stopping_) return;
        seen = generation_;
        loop = loop_;
        ++active_;
      }
      share(*loop);
      {
        const std::lock_guard lock(mutex_);
        --active_;
      }
      done_.notify_all();
    }
  }

  static thread_local bool inside_;
  std::mutex busy_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  std::vector<std::thread> workers_;
  Loop* loop_ = nullptr;
  std::uint64_t generation_ = 0;
  int active_ = 0;
  bool stopping_ = false;
};
thread_local bool ThreadPool::inside_ = false;

class ProgramHost final : public Host {
 public:
  ProgramHost(std::shared_ptr<const PluginRegistry> registry, const HostOptions& options)
      : registry_(std::move(registry)),
        options_(options),
        threads_(options.threads > 0 ? options.threads : allowed_processors()),
        pool_(threads_) {}

  std::vector<ConfigNode> files(const std::string& kind, const ConfigNode& slot) override {
    return registry_->files(kind, slot);
  }
  int threads() const override { return threads_; }
  void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) override {
    pool_.run(count, body);
  }
  bool cancelled() const override { return options_.cancel != nullptr && options_.cancel->load(); }
  void log(LogLevel level, const std::string& message) override {
    if (!options_.log) return;
    const std::lock_guard lock(log_mutex_);
    options_.log(level, message);
  }
  std::uint64_t seed() const override { return options_.seed; }

 protected:
  std::shared_ptr<void> create_erased(const std::string& kind, const ConfigNode& slot) override {
    auto [object, entry] = registry_->create(kind, slot, *this);
    return checked(kind, entry.name, std::move(object), options_.checks);
  }

 private:
  std::shared_ptr<const PluginRegistry> registry_;
  HostOptions options_;
  int threads_;
  std::mutex log_mutex_;
  ThreadPool pool_;
};

}  // namespace

std::unique_ptr<Host> make_host(std::shared_ptr<const PluginRegistry> registry, const HostOptions& options) {
  return std::make_unique<ProgramHost>(std::move(registry), options);
}

}  // namespace weft
