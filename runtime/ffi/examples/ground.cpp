// From a picture and its calibration to depth, ground and attention, with the C++17 wrapper:
//
//   ground PICTURE.ppm CALIBRATION DEPTH.pgm [KERNEL]
//
// Files as in depth.c. Prints how far the ground reaches and how much of it is trusted.
#include <gedepth.hpp>

#include <cstdlib>
#include <exception>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

namespace {

struct Image {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint8_t> rgb;
};

Image read_ppm(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string magic;
  unsigned greatest = 0;
  Image image;
  file >> magic >> image.width >> image.height >> greatest;
  file.get();
  if (!file || magic != "P6" || greatest != 255 || image.width > 16384 || image.height > 16384)
    throw std::runtime_error(path + ": not a binary PPM of 8 bits");
  image.rgb.resize(3 * std::size_t{image.width} * image.height);
  file.read(reinterpret_cast<char*>(image.rgb.data()), static_cast<std::streamsize>(image.rgb.size()));
  if (!file) throw std::runtime_error(path + ": ends early");
  return image;
}

void write_pgm(const std::string& path, const std::vector<float>& depth, const gedepth_shape& shape) {
  std::ofstream file(path, std::ios::binary);
  file << "P5\n" << shape.map_width << ' ' << shape.map_height << "\n65535\n";
  for (const float metres : depth) {
    const float scaled = metres * 256.0F + 0.5F;
    const unsigned value = scaled < 65535.0F ? static_cast<unsigned>(scaled) : 65535U;
    file.put(static_cast<char>(value >> 8)).put(static_cast<char>(value & 255U));
  }
  if (!file.flush()) throw std::runtime_error(path + ": cannot write");
}

}  // namespace

int main(int arguments, char** argument) try {
  if (arguments < 4 || arguments > 5) {
    std::cerr << "usage: " << argument[0] << " PICTURE.ppm CALIBRATION DEPTH.pgm [KERNEL]\n";
    return 2;
  }
  const Image image = read_ppm(argument[1]);
  gedepth_calibration calibration = gedepth::read_calibration(argument[2]);
  if (calibration.width == 0) {  // the file does not say
    calibration.width = image.width;
    calibration.height = image.height;
  }
  const auto kernel = arguments > 4 ? static_cast<std::uint32_t>(std::atoi(argument[4])) : GEDEPTH_KERNEL_BEST;
  gedepth::Camera camera(gedepth::Model::embedded(kernel), calibration);

  std::vector<float> depth(camera.map_len()), ground(camera.map_len()), attention(camera.map_len());
  gedepth_maps maps{};
  maps.depth = {depth.data(), depth.size(), 0};
  maps.ground = {ground.data(), ground.size(), 0};
  if (camera.shape().has_attention == 1) maps.attention = {attention.data(), attention.size(), 0};
  const gedepth_picture picture = gedepth::picture(image.rgb.data(), image.rgb.size(), image.width, image.height);
  camera.run(picture, maps);

  std::size_t seen = 0, trusted = 0;
  for (std::size_t i = 0; i < ground.size(); ++i) {
    seen += ground[i] > 0.0F;
    trusted += ground[i] > 0.0F && attention[i] >= 0.5F;
  }
  std::cout << "ground in " << 100 * seen / ground.size() << " % of the pixels, trusted in "
            << 100 * trusted / ground.size() << " %\n";
  write_pgm(argument[3], depth, camera.shape());
  return EXIT_SUCCESS;
} catch (const std::exception& error) {
  std::cerr << error.what() << '\n';
  return EXIT_FAILURE;
}
