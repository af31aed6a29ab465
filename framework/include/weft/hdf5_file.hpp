#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "weft/error.hpp"
#include "weft/types.hpp"

namespace weft {

/// An HDF5 file of plain arrays and texts. Use one object on one thread; calls into the HDF5 library are locked.
/// Paths are "/group/name"; groups are made as needed. @throws Error naming file and path.
class WEFT_API Hdf5File {
 public:
  /// The new file is in memory until commit(), which writes it beside `file` and renames it: `file` is whole or absent.
  static Hdf5File create(const std::filesystem::path& file);
  /// @throws ConfigError if the file is missing, locked, cut short, damaged or not an HDF5 file; it says which.
  static Hdf5File open(const std::filesystem::path& file);
  Hdf5File(Hdf5File&&) noexcept;
  Hdf5File& operator=(Hdf5File&&) noexcept;
  ~Hdf5File();  ///< a writer that was not committed leaves nothing

  /// Row-major data of the given shape; chunked and compressed when large.
  void write(const std::string& path, const std::vector<Index>& shape, const double* data);
  void write(const std::string& path, const std::vector<Index>& shape, const float* data);
  void write(const std::string& path, const std::vector<Index>& shape, const std::int64_t* data);
  /// Neither chunked nor compressed: parts of it can be read without reading the rest.
  void write_plain(const std::string& path, const std::vector<Index>& shape, const float* data);
  void write(const std::string& path, const std::string& text);
  /// Stored as 16-bit floats: exact for values that have 11 significant bits.
  void write_half(const std::string& path, const std::vector<Index>& shape, const float* data);
  template <class Derived>
  void write(const std::string& path, const Eigen::PlainObjectBase<Derived>& array) {
    using RowMajor = Eigen::Matrix<typename Derived::Scalar, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    const RowMajor copy = array;
    if constexpr (Derived::ColsAtCompileTime == 1) {
      write(path, {copy.rows()}, copy.data());
    } else {
      write(path, {copy.rows(), copy.cols()}, copy.data());
    }
  }
  /// @throws Error naming the file and the reason, such as a full disk. Then nothing is left.
  void commit();

  bool has(const std::string& path) const;
  std::vector<std::string> list(const std::string& group) const;  ///< names in a group, sorted
  std::vector<Index> shape(const std::string& path) const;
  /// The first byte in the file of an array that lies there as 32-bit floats of this machine, one after the other.
  /// Nothing if it is stored otherwise, or is empty.
  std::optional<std::uint64_t> place(const std::string& path) const;
  /// Converts from the stored number type. Refuses arrays above `max_elements` before allocating.
  std::vector<double> read(const std::string& path, std::size_t max_elements = 1u << 30) const;
  std::vector<float> read_float(const std::string& path, std::size_t max_elements = 1u << 30) const;
  std::vector<std::int64_t> read_int(const std::string& path, std::size_t max_elements = 1u << 30) const;
  std::string read_text(const std::string& path) const;
  /// [n, 3] array. @throws ConfigError if it has another shape or holds a non-finite number.
  Positions read_positions(const std::string& path) const;

 private:
  struct Impl;
  explicit Hdf5File(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace weft
