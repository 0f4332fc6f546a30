"""The camera in others' formats: ROS camera_info, OpenCV FileStorage, kalibr camchain, mrcal cameramodel."""

from planeopt.formats.convert import Exported, ExportFormat, ImportFormat, export_camera, import_camera
from planeopt.formats.imported import Imported

__all__ = ["ExportFormat", "Exported", "ImportFormat", "Imported", "export_camera", "import_camera"]
