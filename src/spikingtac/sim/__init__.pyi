"""Public names of the digital twin."""

# Scenes: what touches the skin and how, as a stream or as a recording folder
from .catalog import TRAJECTORIES as TRAJECTORIES
from .catalog import load_scene as load_scene
from .catalog import scene_descriptions as scene_descriptions
from .catalog import scene_names as scene_names
from .motions import IndenterMotion as IndenterMotion
from .motions import MotionConfig as MotionConfig
from .render import simulate as simulate
from .scene import CameraChoice as CameraChoice
from .scene import ContactConfig as ContactConfig
from .scene import HistoryConfig as HistoryConfig
from .scene import Scene as Scene
from .scene import SkinConfig as SkinConfig
from .motions import SegmentConfig as SegmentConfig
from .source import SceneSource as SceneSource
from .source import SceneStep as SceneStep
from .timeline import Timeline as Timeline
from .source import TruthChunk as TruthChunk
from .optics import image_radius_px as image_radius_px
from .scene import VariationConfig as VariationConfig
from .rig.ur3 import RealTimeArm as RealTimeArm
from .twin_camera import TwinCamera as TwinCamera

# Gel: contact, friction, elastic layer and creep
from .gel import Gel as Gel
from .gel import GelConfig as GelConfig
from .indenters import Indenter as Indenter
from .indenters import IndenterConfig as IndenterConfig
from .indenters import SoftLayer as SoftLayer
from .indenters import make_indenter as make_indenter
from .layer import GridConfig as GridConfig

# Optics: from the skin to the sensor
from .optics import DiscConfig as DiscConfig
from .optics import Optics as Optics
from .optics import OpticsConfig as OpticsConfig
from .optics import MarkerImage as MarkerImage
from .optics import SkinState as SkinState

# Event camera: pixels, light, noise and readout
from .camera.event_camera import EventCamera as EventCamera
from .camera.event_camera import ReferenceHistory as ReferenceHistory
from .camera.config import CAMERA_NAMES as CAMERA_NAMES
from .camera.config import BackgroundConfig as BackgroundConfig
from .camera.config import CameraConfig as CameraConfig
from .camera.config import LightConfig as LightConfig
from .camera.config import PixelConfig as PixelConfig
from .camera.config import ReadoutConfig as ReadoutConfig
from .camera.config import load_camera as load_camera

# Robot rig: arm, grasped probe, gel pads and walls
from .rig.rig import VIBRATION_MM as VIBRATION_MM
from .rig.rig import SensingFinger as SensingFinger
from .rig.rig import grip_camera as grip_camera
from .rig.hole_site import HoleSite as HoleSite
from .rig.hole_site import HoleTrial as HoleTrial
from .rig.hole_site import hole_trial as hole_trial
from .rig.pad import Pad as Pad
from .rig.probe import Probe as Probe
from .rig.probe import Grasp as Grasp
from .rig.probe import ProbeState as ProbeState
from .rig.rig import FirstContact as FirstContact
from .rig.rig import Rig as Rig
from .rig.ur3 import ACCELERATION_MM_S2 as ACCELERATION_MM_S2
from .rig.ur3 import SERVO_LAG_S as SERVO_LAG_S
from .rig.ur3 import REPEATABILITY_MM as REPEATABILITY_MM
from .rig.ur3 import UR3Twin as UR3Twin
from .rig.probe import Vibration as Vibration
from .rig.walls import Bit as Bit
from .rig.walls import HoleWall as HoleWall
from .rig.walls import NoWall as NoWall
from .rig.walls import PlaneWall as PlaneWall
from .rig.walls import Wall as Wall

# Probing on the twin: calibration on a flat wall, readings of arms of different repeatability
from .rig.hole_site import PLANNING_MM as PLANNING_MM
from .rig.hole_site import SIGMAS_MM as SIGMAS_MM
from .rig.hole_site import RecordingProber as RecordingProber
from .rig.hole_site import touched_of as touched_of
from .rig.hole_site import CORNER_MM as CORNER_MM
from .rig.hole_site import CROSS as CROSS
from .rig.hole_site import DEFAULT as DEFAULT
from .rig.hole_site import STYLES as STYLES
from .rig.hole_site import prober_for as prober_for
from .rig.hole_site import quiet_windows as quiet_windows
from .rig.hole_site import touch_flat_wall as touch_flat_wall
from .rig.hole_site import touch_flat_walls as touch_flat_walls
from .rig.hole_site import travel_of as travel_of

# What the experiments use besides
from .camera.coverage import discs_of as discs_of
from .camera.coverage import edge_coverage_kernel as edge_coverage_kernel
from .camera.pixels import intensity_kernel as intensity_kernel
from .camera.pixels import log_intensity_kernel as log_intensity_kernel
from .camera.pixels import change_below_threshold_kernel as change_below_threshold_kernel
from .camera.pixels import emit_crossings_kernel as emit_crossings_kernel
from .camera.readout import background_events_kernel as background_events_kernel
from .rig.probe import transition as transition
