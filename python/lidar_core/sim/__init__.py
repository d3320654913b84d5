"""Simulated LiDAR scans with the truth about them: scenes, sensors, motions, targets."""

from lidar_core.sim import scenes
from lidar_core.sim.air import Dust, Rain
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.insert import InsertedFlight, insert_target, with_target
from lidar_core.sim.lidar import LidarModel, Rosette, Spinning
from lidar_core.sim.meshes import hexacopter_mesh, sphere_mesh
from lidar_core.sim.motions import (
    Circle,
    Hover,
    Loop,
    RandomMotion,
    Shuttle,
    TakeOff,
    Waypoints,
)
from lidar_core.sim.noise import NoisyPoses, PoseNoise
from lidar_core.sim.recording import Recorded, record
from lidar_core.sim.shapes import Box, Cylinder, HeightField, Hexacopter, Mesh, Plane, Sphere, Tree
from lidar_core.sim.simulator import SimulatedScan, Simulator, TargetTruth, simulate
from lidar_core.sim.steering import SteeredSensor, Steering

__all__ = [
    "Body",
    "Box",
    "Circle",
    "Cylinder",
    "Dust",
    "HeightField",
    "Hexacopter",
    "Hover",
    "InsertedFlight",
    "LidarModel",
    "Loop",
    "Mesh",
    "NoisyPoses",
    "Plane",
    "PoseNoise",
    "Rain",
    "RandomMotion",
    "Recorded",
    "Rosette",
    "Scene",
    "Shuttle",
    "SimulatedScan",
    "Simulator",
    "Sphere",
    "Spinning",
    "SteeredSensor",
    "Steering",
    "TakeOff",
    "Target",
    "TargetTruth",
    "Tree",
    "Waypoints",
    "hexacopter_mesh",
    "insert_target",
    "record",
    "scenes",
    "simulate",
    "sphere_mesh",
    "with_target",
]
