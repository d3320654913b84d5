// OctoMap takes the scans of a folder into one tree: `octomap FOLDER default|lazy`.
#include "scans.hpp"

#include <octomap/OcTree.h>

// As the others get it: the return if it is near, else a point beyond the greatest range.
static octomap::Pointcloud ends(const Scan& scan) {
  octomap::Pointcloud cloud;
  for (const Ray& ray : scan.rays) {
    double square = 0.0;
    std::array<double, 3> end{};
    for (int axis = 0; axis < 3; ++axis) {
      end[axis] = ray.end[axis];
      square += (end[axis] - scan.origin[axis]) * (end[axis] - scan.origin[axis]);
    }
    if (!(std::sqrt(square) <= MAX_RANGE)) {
      for (int axis = 0; axis < 3; ++axis) {
        end[axis] = scan.origin[axis] + (MAX_RANGE + 0.5) * ray.direction[axis];
      }
    }
    cloud.push_back(static_cast<float>(end[0]), static_cast<float>(end[1]), static_cast<float>(end[2]));
  }
  return cloud;
}

int main(int count, char** words) {
  if (count != 3) {
    return 2;
  }
  const std::vector<Scan> scans = read_scans(words[1]);
  const bool lazy = std::string(words[2]) == "lazy";
  std::vector<octomap::Pointcloud> clouds;
  for (const Scan& scan : scans) {
    clouds.push_back(ends(scan));
  }
  octomap::OcTree tree(VOXEL_SIZE);
  return serve(scans.size(), [&](std::size_t scan) {
    const auto& [x, y, z] = scans[scan].origin;
    const octomap::point3d origin(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
    tree.insertPointCloud(clouds[scan], origin, MAX_RANGE, lazy, lazy);
    return tree.size();
  });
}
