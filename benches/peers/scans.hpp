// Scans that `yardstick write` left in a folder, and the loop in which a system takes its turns.
#pragma once

#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>
#include <vector>

constexpr double MAX_RANGE = 20.0;
constexpr double VOXEL_SIZE = 0.25;
constexpr double TOLERANCE = 0.25;

struct Ray {
  std::array<float, 3> direction;
  std::array<float, 3> end;  // NaN without return
};

struct Scan {
  std::array<double, 3> origin;
  std::vector<Ray> rays;
};

template <typename Row>
std::vector<Row> read_rows(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) {
    std::cerr << path << ": cannot be read\n";
    std::exit(1);
  }
  std::vector<Row> rows(static_cast<std::size_t>(file.tellg()) / sizeof(Row));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(rows.data()), static_cast<std::streamsize>(rows.size() * sizeof(Row)));
  return rows;
}

inline std::vector<Scan> read_scans(const std::string& folder) {
  std::vector<Scan> scans;
  for (const auto& origin : read_rows<std::array<double, 3>>(folder + "/origins.f64")) {
    scans.push_back({origin, read_rows<Ray>(folder + "/" + std::to_string(scans.size()) + ".f32")});
  }
  return scans;
}

// A line with the number of a scan comes in, a line with a count goes out.
inline int serve(std::size_t scans, const std::function<std::size_t(std::size_t)>& work) {
  std::cout << "ready" << std::endl;
  for (std::size_t scan; std::cin >> scan;) {
    if (scan >= scans) {
      return 1;
    }
    std::cout << work(scan) << std::endl;
  }
  return 0;
}
