// Denoises a grey image (binary PGM, 8 bits) with onnxruntime in C++17.
//
//   simnfnd export-weights simnfnd --to onnx --out any.onnx
//   g++ -std=c++17 -O2 -I ort/include onnx_denoise.cpp -L ort/lib -lonnxruntime -o onnx_denoise
//   ./onnx_denoise any.onnx image.pgm denoised.pgm
//
// ort: a release of onnxruntime for your system (Linux x64 or aarch64) from its project.  For pings with
// known beams export with `--geometry polar` and give the opening angle in degrees, and the first
// range as a part of the last one:
//
//   ./onnx_denoise polar.onnx ping.pgm denoised.pgm 130 0.1

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <onnxruntime_cxx_api.h>

struct Image {
  int64_t height = 0;
  int64_t width = 0;
  std::vector<uint8_t> grey;
};

Image read_pgm(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string magic;
  int largest = 0;
  Image image;
  file >> magic >> image.width >> image.height >> largest;
  if (!file || magic != "P5" || largest != 255 || image.width < 1 || image.height < 1) {
    throw std::runtime_error(path + ": no binary PGM of 8 bits without comments");
  }
  file.get();
  image.grey.resize(image.height * image.width);
  file.read(reinterpret_cast<char*>(image.grey.data()), image.grey.size());
  if (!file) throw std::runtime_error(path + ": is cut short");
  return image;
}

void write_pgm(const std::string& path, const Image& image) {
  std::ofstream file(path, std::ios::binary);
  file << "P5\n" << image.width << " " << image.height << "\n255\n";
  file.write(reinterpret_cast<const char*>(image.grey.data()), image.grey.size());
}

// Planes of height x width by the names of the inputs, as docs/how-to/deploy.md has them.
using Planes = std::map<std::string, std::vector<float>>;

void add_polar_maps(Planes& planes, const Image& image, double opening_deg, double near_fraction) {
  const double opening_rad = opening_deg * std::acos(-1.0) / 180;
  for (int64_t row = 0; row < image.height; ++row) {
    for (int64_t column = 0; column < image.width; ++column) {
      const double along = (row + 0.5) / image.height;
      const double across = (column + 0.5) / image.width - 0.5;
      planes["range_fraction"].push_back(near_fraction + (1 - near_fraction) * along);
      planes["azimuth_rad"].push_back(opening_rad * across);
      planes["sector"].push_back(1);
    }
  }
}

int run(int count, char** words) {
  if (count < 4) {
    std::cerr << "onnx_denoise MODEL.onnx IMAGE.pgm DENOISED.pgm [OPENING_DEG [NEAR_FRACTION]]\n";
    return 2;
  }
  Image image = read_pgm(words[2]);
  Planes planes;
  for (uint8_t grey : image.grey) planes["noisy"].push_back(grey / 255.0f);
  if (count > 4) {
    add_polar_maps(planes, image, std::atof(words[4]), count > 5 ? std::atof(words[5]) : 0.0);
  }

  Ort::Env environment(ORT_LOGGING_LEVEL_WARNING, "onnx_denoise");
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(1);
  Ort::Session session(environment, words[1], options);
  Ort::AllocatorWithDefaultOptions allocator;
  const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  const std::array<int64_t, 4> shape{1, 1, image.height, image.width};

  std::vector<std::string> names;
  std::vector<Ort::Value> values;
  for (size_t index = 0; index < session.GetInputCount(); ++index) {
    names.push_back(session.GetInputNameAllocated(index, allocator).get());
    auto plane = planes.find(names.back());
    if (plane == planes.end()) {
      throw std::runtime_error(names.back() + ": the model needs it; give the opening angle");
    }
    values.push_back(Ort::Value::CreateTensor<float>(memory, plane->second.data(),
                                                     plane->second.size(), shape.data(), 4));
  }
  std::vector<const char*> inputs;
  for (const std::string& name : names) inputs.push_back(name.c_str());
  const char* output = "denoised";
  auto results = session.Run(Ort::RunOptions{nullptr}, inputs.data(), values.data(), values.size(),
                             &output, 1);

  const float* denoised = results[0].GetTensorData<float>();
  for (size_t pixel = 0; pixel < image.grey.size(); ++pixel) {
    const float grey = std::min(std::max(denoised[pixel], 0.0f), 1.0f);
    image.grey[pixel] = static_cast<uint8_t>(std::lround(255 * grey));
  }
  write_pgm(words[3], image);
  return 0;
}

int main(int count, char** words) {
  try {
    return run(count, words);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
