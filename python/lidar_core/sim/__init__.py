"""Simulated LiDAR scans, 3D and 2D, with the truth: scenes, sensors, motions, targets."""

from lidar_core.objects import ObjectTruth, TargetTruth
from lidar_core.sim import circle_scenes, scenes, surfaces
from lidar_core.sim.air import Dust, Fog, Rain
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.insertion.insert import InsertedFlight, insert_target, with_target
from lidar_core.sim.insertion.insert_moving import with_moving_target
from lidar_core.sim.insertion.inserted import SolidTarget
from lidar_core.sim.insertion.ray_pattern import RayPattern
from lidar_core.sim.lidar import Beam, LidarModel, Planar, Rosette, Spinning
from lidar_core.sim.motion.motions import (
    Circle,
    Hover,
    Loop,
    RandomMotion,
    Shuttle,
    TakeOff,
    Waypoints,
)
from lidar_core.sim.motion.paths import FigureEight, StopAndGo, Swinging, Wandering
from lidar_core.sim.motion.steering import SteeredSensor, Steering
from lidar_core.sim.noise import NoisyPoses, PoseNoise
from lidar_core.sim.overflight import Overflight, Overflown, overfly
from lidar_core.sim.recording import Recorded, record
from lidar_core.sim.simulator import Simulator, simulate, sweeps
from lidar_core.sim.solids.meshes import hexacopter_mesh, quadcopter_mesh, sphere_mesh
from lidar_core.sim.solids.people import Barrel, Person
from lidar_core.sim.solids.shapes import (
    Box,
    Cylinder,
    EllipticCylinder,
    HeightField,
    Hexacopter,
    Mesh,
    Plane,
    Quadcopter,
    Sphere,
    Tree,
)
from lidar_core.sim.surfaces import Surface
from lidar_core.sim.truth import SimulatedScan, SimulatedSweep

__all__ = [
    "Barrel",
    "Beam",
    "Body",
    "Box",
    "Circle",
    "Cylinder",
    "Dust",
    "EllipticCylinder",
    "FigureEight",
    "Fog",
    "HeightField",
    "Hexacopter",
    "Hover",
    "InsertedFlight",
    "LidarModel",
    "Loop",
    "Mesh",
    "NoisyPoses",
    "ObjectTruth",
    "Overflight",
    "Overflown",
    "Person",
    "Planar",
    "Plane",
    "PoseNoise",
    "Quadcopter",
    "Rain",
    "RandomMotion",
    "RayPattern",
    "Recorded",
    "Rosette",
    "Scene",
    "Shuttle",
    "SimulatedScan",
    "SimulatedSweep",
    "Simulator",
    "SolidTarget",
    "Sphere",
    "Spinning",
    "SteeredSensor",
    "Steering",
    "StopAndGo",
    "Surface",
    "Swinging",
    "TakeOff",
    "Target",
    "TargetTruth",
    "Tree",
    "Wandering",
    "Waypoints",
    "circle_scenes",
    "hexacopter_mesh",
    "insert_target",
    "overfly",
    "quadcopter_mesh",
    "record",
    "scenes",
    "simulate",
    "sphere_mesh",
    "surfaces",
    "sweeps",
    "with_moving_target",
    "with_target",
]


def __dir__() -> list[str]:
    return __all__
