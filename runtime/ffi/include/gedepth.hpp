// gedepth for C++17: handles that close themselves, errors as exceptions. Optional; gedepth.h is the interface, and says
// what holds.
#ifndef GEDEPTH_HPP
#define GEDEPTH_HPP

#include "gedepth.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

namespace gedepth {

// A call failed. `code()` is one of GEDEPTH_*, `what()` the text of gedepth_last_error().
class Error : public std::runtime_error {
 public:
  explicit Error(std::int32_t code) : std::runtime_error(gedepth_last_error()), code_(code) {}

  std::int32_t code() const noexcept { return code_; }

 private:
  std::int32_t code_;
};

// Throws an Error unless `result` is GEDEPTH_OK.
inline void check(std::int32_t result) {
  if (result != GEDEPTH_OK) throw Error(result);
}

// Reads a calibration file.
inline gedepth_calibration read_calibration(const std::string& path) {
  gedepth_calibration calibration{};
  check(gedepth_calibration_read(path.c_str(), &calibration));
  return calibration;
}

// The ground that a calibration's R, T and plane give.
inline gedepth_ground ground_of(const gedepth_calibration& calibration) {
  gedepth_ground ground{};
  check(gedepth_ground_of_calibration(&calibration, &ground));
  return ground;
}

// The ground under a camera: metres, radians (positive pitch looks down, positive roll lowers the right side).
inline gedepth_ground ground_of(double height, double pitch, double roll) {
  gedepth_ground ground{};
  check(gedepth_ground_of_mounting(height, pitch, roll, &ground));
  return ground;
}

// A picture of one plane without padding; set `stride` where there is some, and `chroma` of NV12.
inline gedepth_picture picture(const std::uint8_t* bytes, std::size_t bytes_len, std::uint32_t width, std::uint32_t height,
                               std::uint32_t format = GEDEPTH_FORMAT_RGB,
                               std::uint32_t yuv = GEDEPTH_YUV_BT601_LIMITED) {
  gedepth_picture picture{};
  picture.bytes = bytes;
  picture.bytes_len = bytes_len;
  picture.width = width;
  picture.height = height;
  picture.format = format;
  picture.yuv = yuv;
  return picture;
}

class Model {
 public:
  // The model inside the library.
  static Model embedded(std::uint32_t kernel = GEDEPTH_KERNEL_BEST, std::uint32_t threads = 0) {
    gedepth_model* model = nullptr;
    check(gedepth_model_open_embedded(kernel, threads, &model));
    return Model(model);
  }

  static Model from_file(const std::string& path, std::uint32_t kernel = GEDEPTH_KERNEL_BEST,
                         std::uint32_t threads = 0) {
    gedepth_model* model = nullptr;
    check(gedepth_model_open_file(path.c_str(), kernel, threads, &model));
    return Model(model);
  }

  static Model from_memory(const std::uint8_t* bytes, std::size_t bytes_len,
                           std::uint32_t kernel = GEDEPTH_KERNEL_BEST, std::uint32_t threads = 0) {
    gedepth_model* model = nullptr;
    check(gedepth_model_open_memory(bytes, bytes_len, kernel, threads, &model));
    return Model(model);
  }

  const gedepth_model* get() const noexcept { return model_.get(); }

 private:
  struct Close {
    void operator()(gedepth_model* model) const noexcept { gedepth_model_close(model); }
  };

  explicit Model(gedepth_model* model) : model_(model) {}

  std::unique_ptr<gedepth_model, Close> model_;
};

class Camera {
 public:
  Camera(const Model& model, const gedepth_calibration& calibration, const gedepth_options& options = {}) {
    gedepth_camera* camera = nullptr;
    check(gedepth_camera_open(model.get(), &calibration, &options, &camera));
    camera_.reset(camera);
    check(gedepth_camera_shape(camera, &shape_));
  }

  const gedepth_shape& shape() const noexcept { return shape_; }

  // The values of a map without padding.
  std::size_t map_len() const noexcept { return std::size_t{shape_.map_width} * shape_.map_height; }

  // Writes the maps that are not null; false if that took longer than `deadline_ns` (0 is none). Where the quantized engine runs
  // the whole network it allocates nothing unless it throws.
  bool run(const gedepth_picture& picture, const gedepth_maps& maps, std::uint64_t deadline_ns = 0,
           gedepth_times* times = nullptr) {
    const std::int32_t result = gedepth_camera_run(camera_.get(), &picture, &maps, deadline_ns, times);
    if (result != GEDEPTH_DEADLINE) check(result);
    return result == GEDEPTH_OK;
  }

  gedepth_statistics statistics() const {
    gedepth_statistics statistics{};
    check(gedepth_camera_statistics(camera_.get(), &statistics));
    return statistics;
  }

  gedepth_plausibility plausibility() const {
    gedepth_plausibility plausibility{};
    check(gedepth_camera_plausibility(camera_.get(), &plausibility));
    return plausibility;
  }

  gedepth_ground ground() const {
    gedepth_ground ground{};
    check(gedepth_camera_ground(camera_.get(), &ground));
    return ground;
  }

  // From the next picture on.
  void set_ground(const gedepth_ground& ground) { check(gedepth_camera_set_ground(camera_.get(), &ground)); }

  // Its threads on these cores, that of the caller on the first.
  void pin(const std::uint32_t* cores, std::size_t count) { check(gedepth_camera_pin(camera_.get(), cores, count)); }

  gedepth_camera* get() const noexcept { return camera_.get(); }

 private:
  struct Close {
    void operator()(gedepth_camera* camera) const noexcept { gedepth_camera_close(camera); }
  };

  std::unique_ptr<gedepth_camera, Close> camera_;
  gedepth_shape shape_{};
};

}  // namespace gedepth

#endif  // GEDEPTH_HPP
