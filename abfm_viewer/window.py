"""The app's window: draws its panel from what the worker posted, and runs the frame loop."""

from __future__ import annotations

import time
import traceback

import polyscope.imgui as imgui

from abfm import Parameters, TriangleMesh
from abfm.functions import function
from abfm_viewer import opengl
from abfm_viewer.defaults import default_functions
from abfm_viewer.opengl import ps
from abfm_viewer.scene import Scene
from abfm_viewer.worker import Worker

_SECONDS_PER_FRAME, _LEAST_SLEEP = 1 / 30, 0.002
_PANEL_HEIGHT, _MARGIN = 66, 12
_INK = 0xFF222222
_PANEL_FLAGS = (
    imgui.ImGuiWindowFlags_NoDecoration | imgui.ImGuiWindowFlags_NoMove | imgui.ImGuiWindowFlags_NoSavedSettings
)


class Window:
    """A mesh, a default source and target on it, at most one match at a time, and the time that is shown."""

    def __init__(self, mesh: TriangleMesh, title: str, backend: opengl.Backend = opengl.WINDOW) -> None:
        self.mesh, self.title = mesh, title
        self.source_spec, self.target_spec = default_functions(mesh)
        self.source, self.target = function(mesh, self.source_spec), function(mesh, self.target_spec)
        self.parameters = Parameters()
        self.worker: Worker | None = None
        self.time = 0.0
        self.error = ""
        self._drawn: object = None  # what the middle surface shows
        opengl.start(backend, 1500, 900, title=f"abfm - {title}")
        ps.set_build_default_gui_panels(False)
        ps.set_open_imgui_window_for_user_callback(False)
        ps.set_max_fps(-1)  # the GIL is held while polyscope waits for the next frame; `run` waits without it
        ps.set_frame_tick_limit_fps_mode("ignore_limits")
        ps.set_user_callback(self._callback)
        self.scene = Scene(mesh, self.source, self.target)

    def run(self) -> None:
        """Draw frames until the window is closed."""
        try:
            while not ps.window_requests_close():
                self.frame()
        finally:
            if self.worker:
                self.worker.cancel()
                self.worker.wait()

    def frame(self) -> None:
        """Draw one frame and leave the rest of its time to the solver."""
        start = time.perf_counter()
        ps.frame_tick()
        time.sleep(max(_LEAST_SLEEP, _SECONDS_PER_FRAME - (time.perf_counter() - start)))

    def match(self) -> None:
        """Start matching source and target."""
        self.worker = Worker(self.mesh, self.source, self.target, self.parameters)
        self.time = self.parameters.tau

    def status(self) -> str:
        """One line on what is going on."""
        worker = self.worker
        if self.error:
            return self.error
        if worker is None:
            return f"{self.title}: {len(self.mesh.vertices):,} vertices. Match carries the source to the target."
        if worker.error:
            return worker.error
        if worker.latest is None:
            return "starting"
        now = worker.latest
        numbers = f"iteration {now.iteration}   energy {now.energy:.4g}   mismatch {now.mismatch:.4f}"
        if worker.result is None:
            return f"stage {now.stage + 1} of {now.stages}   {numbers}"
        return f"{worker.result.match.stop_reason}   {numbers}"

    def _callback(self) -> None:
        """Draw one frame; an exception that escaped would stop polyscope from drawing ever again."""
        try:
            self._update_scene()
            self._draw_labels()
            self._draw_panel()
        except Exception as error:
            traceback.print_exc()
            self.error = f"{type(error).__name__}: {error}"

    def _update_scene(self) -> None:
        worker = self.worker
        if worker is None:
            return
        if worker.result:
            wanted: object = (worker.result, self.time)
            if wanted != self._drawn:
                self.scene.show_advected(worker.result.advected(self.time))
                self._drawn = wanted
        elif worker.latest is not None and worker.latest is not self._drawn:
            self._drawn = worker.latest
            self.scene.show_advected(worker.latest.advected[:, 0])

    def _draw_labels(self) -> None:
        canvas = imgui.GetBackgroundDrawList()
        for text, (x, y) in self.scene.labels().items():
            width, height = imgui.CalcTextSize(text)
            canvas.AddText((x - width / 2, y - 2 * height), _INK, text)

    def _draw_panel(self) -> None:
        width, height = ps.get_window_size()
        imgui.SetNextWindowPos((_MARGIN, height - _PANEL_HEIGHT - _MARGIN))
        imgui.SetNextWindowSize((width - 2 * _MARGIN, _PANEL_HEIGHT))
        imgui.Begin("controls", _PANEL_FLAGS)
        worker = self.worker
        running = worker is not None and worker.running
        if imgui.Button("Cancel" if running else "Match", (90, 0)):
            if worker and running:
                worker.cancel()
            else:
                self.match()
        imgui.SameLine()
        if imgui.Button("Reset view"):
            self.scene.reset_camera()
        imgui.SameLine()
        if worker and running:
            done = worker.latest.iteration / self.parameters.iterations if worker.latest else 0
            imgui.ProgressBar(done, (-1, 0))
        else:
            imgui.BeginDisabled(worker is None or worker.result is None)
            imgui.SetNextItemWidth(-60)
            _, self.time = imgui.SliderFloat("time", self.time, 0, self.parameters.tau)
            imgui.EndDisabled()
        imgui.TextUnformatted(self.status())
        imgui.End()
