// PCL finds the Euclidean clusters of the returns of a scan: `pcl FOLDER`.
#include "scans.hpp"

#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

static std::size_t clusters(const Cloud::Ptr& cloud) {
  const pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
  tree->setInputCloud(cloud);
  pcl::EuclideanClusterExtraction<pcl::PointXYZ> extraction;
  extraction.setClusterTolerance(TOLERANCE);
  extraction.setMinClusterSize(1);
  extraction.setSearchMethod(tree);
  extraction.setInputCloud(cloud);
  std::vector<pcl::PointIndices> found;
  extraction.extract(found);
  return found.size();
}

int main(int count, char** words) {
  if (count != 2) {
    return 2;
  }
  std::vector<Cloud::Ptr> clouds;
  for (const Scan& scan : read_scans(words[1])) {
    clouds.emplace_back(new Cloud);
    for (const Ray& ray : scan.rays) {
      if (std::isfinite(ray.end[0])) {
        clouds.back()->push_back(pcl::PointXYZ(ray.end[0], ray.end[1], ray.end[2]));
      }
    }
  }
  return serve(clouds.size(), [&](std::size_t scan) { return clusters(clouds[scan]); });
}
