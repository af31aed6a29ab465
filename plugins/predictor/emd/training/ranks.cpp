// Ranks on c10d, the layer of libtorch that connects processes. Nothing else of the training library includes it.
#include "ranks.hpp"

#ifdef WEFT_HAS_GLOO
#define USE_C10D_GLOO
#include <ATen/ATen.h>
#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <thread>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>
#include <utility>
#endif

namespace weft::emd {

#ifdef WEFT_HAS_GLOO
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using SteadyClock = std::chrono::steady_clock;

// A rank reads and hashes the data before it joins, and the file server of another node may be slow.
constexpr milliseconds kJoinTime = std::chrono::minutes(30), kAnswerTime = std::chrono::minutes(10);
constexpr const char* kLoopback = "127.0.0.1";

std::string text_of(const in_addr& address) {
  char text[INET_ADDRSTRLEN] = "";
  ::inet_ntop(AF_INET, &address, text, sizeof(text));
  return text;
}
bool is_loopback(const std::string& address) { return address.starts_with("127."); }

/// IPv4 address of an interface, or of the first that is up and no loopback; empty: there is none.
std::string address_of_interface(const std::string& name) {
  ifaddrs* all = nullptr;
  std::string found;
  if (::getifaddrs(&all) != 0) return found;
  for (const ifaddrs* one = all; one != nullptr && found.empty(); one = one->ifa_next) {
    if (one->ifa_addr == nullptr || one->ifa_addr->sa_family != AF_INET || (one->ifa_flags & IFF_UP) == 0) continue;
    if (name.empty() ? (one->ifa_flags & IFF_LOOPBACK) != 0 : name != one->ifa_name) continue;
    found = text_of(reinterpret_cast<const sockaddr_in*>(one->ifa_addr)->sin_addr);
  }
  ::freeifaddrs(all);
  return found;
}

/// IPv4 address of the host name; empty: it has none.
std::string address_of_host() {
  char name[256] = "";
  addrinfo wanted{}, *found = nullptr;
  wanted.ai_family = AF_INET;
  if (::gethostname(name, sizeof(name) - 1) != 0 || ::getaddrinfo(name, nullptr, &wanted, &found) != 0) return "";
  const std::string address = text_of(reinterpret_cast<const sockaddr_in*>(found->ai_addr)->sin_addr);
  ::freeaddrinfo(found);
  return address;
}

/// The address under which the other ranks reach this one.
std::string own_address(const FitRanks& options) {
  if (options.is_one_machine) return kLoopback;
  if (!options.interface.empty()) {
    const std::string address = address_of_interface(options.interface);
    if (address.empty()) throw ConfigError("ranks: this machine has no IPv4 address on '" + options.interface + "'");
    return address;
  }
  // Debian gives the host name an address of the loopback.
  std::string address = address_of_host();
  if (address.empty() || is_loopback(address)) address = address_of_interface("");
  return address.empty() ? kLoopback : address;
}

/// What rank 0 writes into the file of the meeting.
struct Place {
  std::string address;
  std::uint16_t port = 0;
};

void write_place(const fs::path& file, const Place& place) {
  const fs::path written = file.string() + ".tmp";
  std::ofstream stream(written);
  stream << place.address << ' ' << place.port << '\n';
  stream.close();
  std::error_code error;
  if (stream) fs::rename(written, file, error);
  if (!stream || error) throw Error(file.string() + ": cannot be written, so the other ranks find no rank 0");
}

std::string message_of(const std::exception& error) {
  const auto* ours = dynamic_cast<const c10::Error*>(&error);
  const std::string text = ours != nullptr ? ours->what_without_backtrace() : error.what();
  return text.substr(0, text.find('\n'));
}

/// Joins the store of rank 0. The file may be one of ranks that were killed, so what does not answer is asked again.
c10::intrusive_ptr<c10d::TCPStore> join_first(const FitRanks& options) {
  const auto until = SteadyClock::now() + kJoinTime;
  std::string problem = "it does not exist";
  for (; SteadyClock::now() < until; std::this_thread::sleep_for(milliseconds(50))) {
    Place place;
    std::ifstream stream(options.meeting);
    if (!(stream >> place.address >> place.port)) continue;
    try {
      c10d::TCPStoreOptions of_store;
      of_store.port = place.port;
      of_store.waitWorkers = false;
      of_store.timeout = std::chrono::seconds(5);
      auto store = c10::make_intrusive<c10d::TCPStore>(place.address, of_store);
      const auto meeting = store->get("meeting");
      if (std::string(meeting.begin(), meeting.end()) == options.meeting.filename()) return store;
      problem = "another program answers there";
    } catch (const std::exception& error) {
      problem = message_of(error);
    }
  }
  throw Error("ranks: rank " + std::to_string(options.rank) + " waited half an hour for rank 0, which writes " +
              options.meeting.string() + " where it is reached: " + problem);
}

at::Tensor bytes_view(const std::byte* data, std::size_t bytes) {
  return at::from_blob(const_cast<std::byte*>(data), {static_cast<std::int64_t>(bytes)},
                       at::TensorOptions().dtype(at::kByte));
}

}  // namespace

struct Ranks::Engine {
  c10::intrusive_ptr<c10d::TCPStore> store;
  c10::intrusive_ptr<c10d::ProcessGroupGloo> group;
  int waits = 0;

  explicit Engine(const FitRanks& options) {
    const std::string address = own_address(options);
    if (options.rank == 0) {
      c10d::TCPStoreOptions of_store;
      of_store.port = 0;  // any that is free
      of_store.isServer = true;
      of_store.waitWorkers = false;
      store = c10::make_intrusive<c10d::TCPStore>(address, of_store);
      const std::string name = options.meeting.filename();
      store->set("meeting", std::vector<std::uint8_t>(name.begin(), name.end()));
      write_place(options.meeting, {address, store->getPort()});
    } else {
      store = join_first(options);
    }
    store->setTimeout(kJoinTime);
    auto of_group = c10d::ProcessGroupGloo::Options::create(kJoinTime);
    of_group->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname(address));
    group = c10::make_intrusive<c10d::ProcessGroupGloo>(store, options.rank, options.size, of_group);
    std::error_code ignored;
    if (options.rank == 0) fs::remove(options.meeting, ignored);  // all have come
  }
};

Ranks::Ranks(const FitRanks& options)
    : rank_(static_cast<std::size_t>(options.rank)), size_(static_cast<std::size_t>(options.size)) {
  if (size_ > 1) together([&] { engine_ = std::make_unique<Engine>(options); });
}
Ranks::~Ranks() = default;

template <class Body>
void Ranks::together(const Body& body) {
  try {
    body();
  } catch (const weft::Error&) {  // of an address, or of the meeting
    throw;
  } catch (const std::exception& error) {
    throw RanksLost("ranks: rank " + std::to_string(rank_) + " of " + std::to_string(size_) +
                    " cannot reach the others, one of which may have died (" + message_of(error) +
                    "); the same command goes on from the checkpoint");
  }
}

void Ranks::wait_for_first() {
  if (!engine_) return;
  together([&] {
    const std::string key = "wait " + std::to_string(engine_->waits++);
    if (is_first())
      engine_->store->set(key, std::vector<std::uint8_t>{1});
    else
      engine_->store->wait({key}, std::chrono::hours(240));  // ends at once when rank 0 dies
  });
}

void Ranks::require_same(const std::string& text) {
  if (!engine_) return;
  std::vector<char> of_first(text.begin(), text.end());
  broadcast(of_first);
  const std::byte is_other{text != std::string(of_first.begin(), of_first.end())};
  std::vector<std::byte> others(size_);
  gather(&is_other, others.data(), 1);
  for (std::size_t r = 0; r < size_; ++r) {
    if (others[r] == std::byte{0}) continue;
    throw ConfigError("ranks: rank " + std::to_string(r) +
                      " fits something else than rank 0: config, data, seed or the numeric variant `kernels` differ");
  }
}

void Ranks::broadcast_bytes(std::byte* values, std::size_t bytes) {
  if (!engine_ || bytes == 0) return;
  together([&] {
    std::vector<at::Tensor> one{bytes_view(values, bytes)};
    c10d::BroadcastOptions options;
    options.timeout = kAnswerTime;
    engine_->group->broadcast(one, options)->wait();
  });
}

void Ranks::exchange(const std::byte* to, std::byte* from, std::size_t bytes) {
  together([&] {
    at::Tensor in = bytes_view(to, size_ * bytes), out = bytes_view(from, size_ * bytes);
    std::vector<std::int64_t> equal;
    c10d::AllToAllOptions options;
    options.timeout = kAnswerTime;
    engine_->group->alltoall_base(out, in, equal, equal, options)->wait();
  });
  bytes_sent_ += (size_ - 1) * bytes;
}

void Ranks::gather(const std::byte* mine, std::byte* all, std::size_t bytes) {
  if (!engine_) {
    std::copy(mine, mine + bytes, all);
    return;
  }
  together([&] {
    std::vector<at::Tensor> in{bytes_view(mine, bytes)};
    std::vector<std::vector<at::Tensor>> out(1);
    for (std::size_t r = 0; r < size_; ++r) out[0].push_back(bytes_view(all + r * bytes, bytes));
    c10d::AllgatherOptions options;
    options.timeout = kAnswerTime;
    engine_->group->allgather(out, in, options)->wait();
  });
  bytes_sent_ += (size_ - 1) * bytes;
}
#else
struct Ranks::Engine {};

Ranks::Ranks(const FitRanks& options)
    : rank_(static_cast<std::size_t>(options.rank)), size_(static_cast<std::size_t>(options.size)) {
  if (size_ > 1)
    throw Unsupported("emd: this build cannot train over ranks: it was made without Gloo (Debian: libgloo-dev)");
}
Ranks::~Ranks() = default;
void Ranks::wait_for_first() {}
void Ranks::require_same(const std::string&) {}
void Ranks::broadcast_bytes(std::byte*, std::size_t) {}
void Ranks::exchange(const std::byte*, std::byte*, std::size_t) {}
void Ranks::gather(const std::byte* mine, std::byte* all, std::size_t bytes) { std::copy(mine, mine + bytes, all); }
#endif

}  // namespace weft::emd
