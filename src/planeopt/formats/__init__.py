"""The camera in others' formats: ROS camera_info, OpenCV FileStorage, kalibr camchain, mrcal cameramodel."""

from planeopt.formats.convert import ExportFormat, ImportFormat, export_camera, import_camera, left_out
from planeopt.formats.imported import Imported

__all__ = ["ExportFormat", "ImportFormat", "Imported", "export_camera", "import_camera", "left_out"]
