#include "weft/hdf5_file.hpp"

#include <hdf5.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <mutex>
#include <optional>

#include "sdk/files.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

// Debian's serial HDF5 is not built thread-safe; weft opens files from several threads.
std::recursive_mutex& library_mutex() {
  static std::recursive_mutex mutex;
  return mutex;
}
using Lock = std::lock_guard<std::recursive_mutex>;

/// Deflate, the strongest filter in use, makes at most 1032 bytes out of one.
constexpr hsize_t kLargestExpansion = 1032;
constexpr hsize_t kLeastChunk = 1 << 20;  // bytes; HDF5 needs memory for a whole chunk, and may keep one this large

herr_t refuse_link(const char*, const char*, const char*, const char*, unsigned*, hid_t, void*) { return -1; }
/// How objects are looked up: links to other files are not followed. A file holds what it says, or it is refused.
hid_t within_the_file(hid_t kind) {
  const hid_t access = H5Pcreate(kind);
  H5Pset_elink_cb(access, refuse_link, nullptr);
  return access;
}
hid_t dataset_access() {  // serves for links as well
  static const hid_t access = within_the_file(H5P_DATASET_ACCESS);
  return access;
}
hid_t group_access() {
  static const hid_t access = within_the_file(H5P_GROUP_ACCESS);
  return access;
}

/// Owns an HDF5 identifier.
class Handle {
 public:
  Handle(hid_t id, herr_t (*close)(hid_t)) : id_(id), close_(close) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  operator hid_t() const { return id_; }
  bool good() const { return id_ >= 0; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

constexpr hsize_t kChunkBytes = 1 << 20;

/// IEEE 754 binary16: sign 1, exponent 5, mantissa 10 bits; h5py reads it as float16.
hid_t half_type() {
  const hid_t half = H5Tcopy(H5T_IEEE_F32LE);
  H5Tset_fields(half, 15, 10, 5, 0, 10);
  H5Tset_size(half, 2);
  H5Tset_ebias(half, 15);
  return half;
}

/// @param bits of a number of half_type(), in the machine's byte order, which is the file's on every machine that weft knows.
float from_half(std::uint16_t bits) {
  const std::uint32_t sign = (bits & 0x8000u) << 16, exponent = (bits >> 10) & 31u, mantissa = bits & 1023u;
  if (exponent == 0) return std::copysign(std::ldexp(static_cast<float>(mantissa), -24), sign != 0 ? -1.0f : 1.0f);
  const std::uint32_t widened = exponent == 31 ? 255u : exponent + 127u - 15u;
  return std::bit_cast<float>(sign | widened << 23 | mantissa << 13);
}

/// Why the last call into the library failed: the descriptions of its error stack. Any other call clears the stack.
std::string last_failure() {
  std::string text;
  const auto add = [](unsigned, const H5E_error2_t* entry, void* data) -> herr_t {
    if (entry->desc != nullptr) *static_cast<std::string*>(data) += std::string(entry->desc) + "\n";
    return 0;
  };
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, add, &text);
  return text;
}

/// The number behind `name` in a text of the library, such as "errno = 28".
std::optional<long long> number_after(const std::string& text, const std::string& name) {
  const auto at = text.find(name);
  if (at == std::string::npos) return std::nullopt;
  long long value = 0;
  const char* begin = text.data() + at + name.size();
  if (std::from_chars(begin, text.data() + text.size(), value).ec != std::errc()) return std::nullopt;
  return value;
}

/// Why a file that can be read cannot be opened, and what to do. @throws ReadError if it cannot be read now.
std::string open_problem(const fs::path& file, const std::string& failure) {
  if (failure.find("unable to lock file") != std::string::npos) {
    throw ReadError(file.string() +
                    ": is locked: another program writes it; wait until that has ended. If the file system has no "
                    "locks, set HDF5_USE_FILE_LOCKING=FALSE");
  }
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  char block[64];
  stream.read(block, sizeof(block));
  if (!stream.is_open() || stream.bad()) throw ReadError(file.string() + ": cannot be read: " + std::strerror(errno));
  const std::string_view beginning(block, stream.gcount());
  if (is_lfs_pointer(beginning)) throw ReadError(file.string() + ": " + kLfsPointer);
  if (beginning.empty()) return "is empty; copy it or make it again";
  if (failure.find("truncated file") != std::string::npos) {
    const auto there = number_after(failure, "eof = "), stored = number_after(failure, "stored_eof = ");
    return "was cut short" +
           (there && stored ? ": it has " + std::to_string(*there) + " of " + std::to_string(*stored) + " bytes" : "") +
           "; copy it or make it again";
  }
  if (!beginning.starts_with("\x89HDF\r\n\x1a\n")) return "is not an HDF5 file";
  return "is damaged; copy it or make it again";
}

}  // namespace

struct Hdf5File::Impl {
  fs::path file;
  bool is_writer = false;
  hid_t id = -1;
  // What was opened last stays open, because shape, type and values are mostly asked for one after the other.
  mutable std::string last_path;
  mutable hid_t last_set = -1;

  ~Impl() {
    const Lock lock(library_mutex());
    close();
  }
  void close() {
    if (last_set >= 0) H5Dclose(last_set);
    if (id >= 0) H5Fclose(id);
    last_set = id = -1;
  }
  [[noreturn]] void fail(const std::string& path, const std::string& message) const {
    throw ConfigError(file.string() + ": " + path + " " + message);
  }
  /// @return valid until the next call; not to be closed.
  hid_t open_dataset(const std::string& path) const {
    if (last_set >= 0 && path == last_path) return last_set;
    if (last_set >= 0) H5Dclose(last_set);
    last_set = H5Dopen2(id, path.c_str(), dataset_access());
    if (last_set < 0) fail(path, "is missing");
    last_path = path;
    return last_set;
  }
  bool exists(const std::string& path) const {
    // HDF5 can check a path only step by step: each step must exist before the next is checked.
    for (std::size_t slash = path.find('/', 1);; slash = path.find('/', slash + 1)) {
      if (H5Lexists(id, path.substr(0, slash).c_str(), dataset_access()) <= 0) return false;
      if (slash == std::string::npos) return true;
    }
  }
  std::vector<Index> shape(hid_t set, const std::string& path) const {
    const Handle space(H5Dget_space(set), H5Sclose);
    if (H5Sget_simple_extent_type(space) != H5S_SIMPLE) return {};
    const int rank = H5Sget_simple_extent_ndims(space);
    if (rank < 0 || rank > 8) fail(path, "has a rank that is not supported");
    std::vector<hsize_t> dims(rank);
    H5Sget_simple_extent_dims(space, dims.data(), nullptr);
    for (const hsize_t n : dims)
      if (n > hsize_t{1} << 48) fail(path, "has an extent that is not supported");
    return {dims.begin(), dims.end()};
  }
  /// A shape says how much memory reading takes, and costs nothing to write. So the file must hold the data as well.
  /// @param bytes of the data, without compression.
  void require_stored(hid_t set, const std::string& path, hsize_t bytes) const {
    hsize_t size = 0;
    H5Fget_filesize(id, &size);
    const hsize_t stored = std::min(H5Dget_storage_size(set), size);
    // Most arrays have a place in the file. Only one that is neither in chunks, nor compressed, nor in another file has.
    if (bytes <= stored && H5Dget_offset(set) != HADDR_UNDEF) return;
    const Handle options(H5Dget_create_plist(set), H5Pclose);
    const auto layout = H5Pget_layout(options);
    if (layout == H5D_VIRTUAL || H5Pget_external_count(options) > 0) fail(path, "keeps its data in another file");
    const hsize_t most = H5Pget_nfilters(options) > 0 ? stored * kLargestExpansion : stored;
    if (bytes > most) {
      fail(path, "has " + std::to_string(bytes) + " bytes by its shape, but the file holds " + std::to_string(stored) +
                     " of it; the file is damaged");
    }
    if (layout != H5D_CHUNKED) return;
    hsize_t chunk[H5S_MAX_RANK] = {}, chunk_bytes = H5Tget_size(Handle(H5Dget_type(set), H5Tclose));
    const int rank = H5Pget_chunk(options, H5S_MAX_RANK, chunk);
    for (int i = 0; i < rank; ++i) {
      if (chunk[i] != 0 && chunk_bytes > std::max(most, kLeastChunk) / chunk[i])
        fail(path, "is stored in chunks that are larger than itself");
      chunk_bytes *= chunk[i];
    }
  }
  template <class T>
  std::vector<T> read(const std::string& path, hid_t type, std::size_t max_elements) const {
    const Lock lock(library_mutex());
    const hid_t set = open_dataset(path);
    const Handle stored(H5Dget_type(set), H5Tclose);
    const auto kind = H5Tget_class(stored);
    if (kind != H5T_INTEGER && kind != H5T_FLOAT) fail(path, "is not an array of numbers");
    if (H5Sget_simple_extent_type(Handle(H5Dget_space(set), H5Sclose)) == H5S_NULL) fail(path, "holds nothing");
    std::size_t count = 1;
    for (const Index n : shape(set, path)) {
      if (n != 0 && count > max_elements / static_cast<std::size_t>(n)) fail(path, "is larger than this program reads");
      count *= static_cast<std::size_t>(n);
    }
    if (H5Tget_size(stored) > 16) fail(path, "holds numbers of a size that is not supported");
    require_stored(set, path, count * H5Tget_size(stored));
    std::vector<T> values(count);
    if (count > 0 && H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
      fail(path, "cannot be read; the file is damaged");
    return values;
  }
  /// @param data of the dataset `set`, which was just made; null: none.
  void store(const std::string& path, const Handle& set, hid_t type, const void* data) const {
    if (set.good() && (data == nullptr || H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) >= 0)) return;
    const std::string failure = last_failure();
    if (!set.good() && exists(path)) throw Error(file.string() + ": " + path + " was written twice");
    throw Error(file.string() + ": " + path + " cannot be written: " + failure);
  }
  void write(const std::string& path, const std::vector<Index>& dims, hid_t type, std::size_t size, const void* data,
             hid_t stored = -1, bool is_plain = false) {
    const Lock lock(library_mutex());
    std::vector<hsize_t> extent(dims.begin(), dims.end());
    hsize_t count = 1;
    for (const hsize_t n : extent) count *= n;
    const Handle space(H5Screate_simple(static_cast<int>(extent.size()), extent.data(), nullptr), H5Sclose);
    const Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose);
    H5Pset_create_intermediate_group(links, 1);
    const Handle options(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
    H5Pset_obj_track_times(options, false);  // same content, same bytes
    if (count * size > 4096 && !extent.empty() && !is_plain) {
      auto chunk = extent;
      const hsize_t row = std::max<hsize_t>(1, count / extent[0]) * size;
      chunk[0] = std::clamp<hsize_t>(kChunkBytes / row, 1, extent[0]);
      H5Pset_chunk(options, static_cast<int>(chunk.size()), chunk.data());
      H5Pset_shuffle(options);
      H5Pset_deflate(options, 4);
    }
    const Handle set(H5Dcreate2(id, path.c_str(), stored < 0 ? type : stored, space, links, options, H5P_DEFAULT),
                     H5Dclose);
    store(path, set, type, count > 0 ? data : nullptr);
  }
};

Hdf5File::Hdf5File(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Hdf5File::Hdf5File(Hdf5File&&) noexcept = default;
Hdf5File& Hdf5File::operator=(Hdf5File&&) noexcept = default;
Hdf5File::~Hdf5File() = default;

Hdf5File Hdf5File::create(const fs::path& file) {
  const Lock lock(library_mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  auto impl = std::make_unique<Impl>();
  impl->file = file;
  impl->is_writer = true;
  // The library writes into memory, and commit() into the file: when the library cannot write a part to the disk, it
  // does not always say so.
  constexpr std::size_t kGrowsBy = 4 << 20;
  const Handle options(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_fapl_core(options, kGrowsBy, false);
  impl->id = H5Fcreate(file.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, options);
  if (impl->id < 0) throw Error(file.string() + ": cannot be made in memory: " + last_failure());
  return Hdf5File(std::move(impl));
}

Hdf5File Hdf5File::open(const fs::path& file) {
  const Lock lock(library_mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  std::error_code ignored;
  if (!fs::exists(file, ignored)) throw ConfigError(file.string() + ": does not exist");
  if (const std::string other = no_file(file); !other.empty())
    throw ConfigError(file.string() + ": " + other + ", must be an HDF5 file");
  auto impl = std::make_unique<Impl>();
  impl->file = file;
  impl->id = H5Fopen(file.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (impl->id < 0) throw ConfigError(file.string() + ": " + open_problem(file, last_failure()));
  return Hdf5File(std::move(impl));
}

void Hdf5File::write(const std::string& path, const std::vector<Index>& shape, const double* data) {
  impl_->write(path, shape, H5T_NATIVE_DOUBLE, sizeof(double), data);
}
void Hdf5File::write(const std::string& path, const std::vector<Index>& shape, const float* data) {
  impl_->write(path, shape, H5T_NATIVE_FLOAT, sizeof(float), data);
}
void Hdf5File::write(const std::string& path, const std::vector<Index>& shape, const std::int64_t* data) {
  impl_->write(path, shape, H5T_NATIVE_INT64, sizeof(std::int64_t), data);
}

void Hdf5File::write_plain(const std::string& path, const std::vector<Index>& shape, const float* data) {
  impl_->write(path, shape, H5T_NATIVE_FLOAT, sizeof(float), data, -1, true);
}

void Hdf5File::write_half(const std::string& path, const std::vector<Index>& shape, const float* data) {
  const Lock lock(library_mutex());
  impl_->write(path, shape, H5T_NATIVE_FLOAT, sizeof(float), data, Handle(half_type(), H5Tclose));
}

void Hdf5File::write(const std::string& path, const std::string& text) {
  const Lock lock(library_mutex());
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
  H5Tset_size(type, std::max<std::size_t>(1, text.size()));
  H5Tset_cset(type, H5T_CSET_UTF8);
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  const Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose);
  H5Pset_create_intermediate_group(links, 1);
  const Handle options(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
  H5Pset_obj_track_times(options, false);
  const Handle set(H5Dcreate2(impl_->id, path.c_str(), type, space, links, options, H5P_DEFAULT), H5Dclose);
  impl_->store(path, set, type, text.empty() ? "\0" : text.data());
}

void Hdf5File::commit() {
  const Lock lock(library_mutex());
  if (!impl_->is_writer || impl_->id < 0) throw Error(impl_->file.string() + ": nothing to commit");
  std::string image;
  bool good = H5Fflush(impl_->id, H5F_SCOPE_GLOBAL) >= 0;
  const ssize_t size = good ? H5Fget_file_image(impl_->id, nullptr, 0) : -1;
  if (size > 0) image.resize(static_cast<std::size_t>(size));
  good = size > 0 && H5Fget_file_image(impl_->id, image.data(), image.size()) == size;
  const std::string failure = last_failure();
  impl_->close();
  if (!good) throw Error(impl_->file.string() + ": cannot be written: " + failure);
  write_text(impl_->file, image);
}

bool Hdf5File::has(const std::string& path) const {
  const Lock lock(library_mutex());
  return impl_->exists(path);
}

std::vector<std::string> Hdf5File::list(const std::string& group) const {
  const Lock lock(library_mutex());
  std::vector<std::string> names;
  const Handle handle(H5Gopen2(impl_->id, group.c_str(), group_access()), H5Gclose);
  if (!handle.good()) impl_->fail(group, "is missing");
  H5G_info_t info{};
  H5Gget_info(handle, &info);
  for (hsize_t i = 0; i < info.nlinks; ++i) {
    const auto size = H5Lget_name_by_idx(handle, ".", H5_INDEX_NAME, H5_ITER_INC, i, nullptr, 0, H5P_DEFAULT);
    if (size < 0) impl_->fail(group, "cannot be listed; the file is damaged");
    std::string name(static_cast<std::size_t>(size) + 1, '\0');
    H5Lget_name_by_idx(handle, ".", H5_INDEX_NAME, H5_ITER_INC, i, name.data(), name.size(), H5P_DEFAULT);
    name.pop_back();
    names.push_back(std::move(name));
  }
  return names;
}

std::vector<Index> Hdf5File::shape(const std::string& path) const {
  const Lock lock(library_mutex());
  const hid_t set = impl_->open_dataset(path);
  return impl_->shape(set, path);
}

std::optional<std::uint64_t> Hdf5File::place(const std::string& path) const {
  const Lock lock(library_mutex());
  const hid_t set = impl_->open_dataset(path);
  const Handle type(H5Dget_type(set), H5Tclose);
  const Handle options(H5Dget_create_plist(set), H5Pclose);
  if (H5Pget_layout(options) != H5D_CONTIGUOUS || H5Pget_external_count(options) > 0) return std::nullopt;
  if (H5Tequal(type, H5T_NATIVE_FLOAT) <= 0) return std::nullopt;
  const haddr_t at = H5Dget_offset(set);
  if (at == HADDR_UNDEF) return std::nullopt;
  hsize_t bytes = sizeof(float);
  for (const Index n : impl_->shape(set, path)) bytes *= static_cast<hsize_t>(n);
  impl_->require_stored(set, path, bytes);
  return at;
}

std::vector<double> Hdf5File::read(const std::string& path, std::size_t max_elements) const {
  return impl_->read<double>(path, H5T_NATIVE_DOUBLE, max_elements);
}
std::vector<float> Hdf5File::read_float(const std::string& path, std::size_t max_elements) const {
  const Lock lock(library_mutex());
  const Handle half(half_type(), H5Tclose);
  if (H5Tequal(Handle(H5Dget_type(impl_->open_dataset(path)), H5Tclose), half) <= 0)
    return impl_->read<float>(path, H5T_NATIVE_FLOAT, max_elements);
  // libhdf5 converts them bit by bit, which takes 0.1 us a number.
  const auto bits = impl_->read<std::uint16_t>(path, half, max_elements);
  std::vector<float> values(bits.size());
  std::transform(bits.begin(), bits.end(), values.begin(), from_half);
  return values;
}
std::vector<std::int64_t> Hdf5File::read_int(const std::string& path, std::size_t max_elements) const {
  return impl_->read<std::int64_t>(path, H5T_NATIVE_INT64, max_elements);
}

std::string Hdf5File::read_text(const std::string& path) const {
  const Lock lock(library_mutex());
  const hid_t set = impl_->open_dataset(path);
  const Handle type(H5Dget_type(set), H5Tclose);
  const Handle space(H5Dget_space(set), H5Sclose);
  constexpr std::size_t kLongest = 64u << 20;
  if (H5Tget_class(type) != H5T_STRING || H5Tis_variable_str(type) > 0 || H5Sget_simple_extent_npoints(space) != 1 ||
      H5Tget_size(type) > kLongest) {
    impl_->fail(path, "is not a text");
  }
  impl_->require_stored(set, path, H5Tget_size(type));
  std::string text(H5Tget_size(type), '\0');
  if (H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, text.data()) < 0)
    impl_->fail(path, "cannot be read; the file is damaged");
  text.resize(text.find_last_not_of('\0') + 1);
  return text;
}

Positions Hdf5File::read_positions(const std::string& path) const {
  const auto dims = shape(path);
  if (dims.size() != 2 || dims[1] != 3) impl_->fail(path, "must have the shape [n, 3]");
  const auto values = read(path);
  for (const double value : values) {
    if (!std::isfinite(value)) impl_->fail(path, "holds a number that is not finite");
  }
  return Eigen::Map<const Positions>(values.data(), dims[0], 3);
}

}  // namespace weft
