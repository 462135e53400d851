"""Names of the stages that jobs call, each loaded when it is first used: to load all of them takes seconds."""

# ruff: noqa: F401, I001
from typing import TYPE_CHECKING

from common.lazy import lazily

if TYPE_CHECKING:
    from dataset.finite_strain import borne, n_groups, require_finite
    from dataset.indentation import largest_strain, samples_of as samples_of_contacts, write_contact
    from dataset.leaves import is_zarr, require_zarr_place
    from dataset.loads import PAPERS, Loads, loads_of
    from dataset.measurement import ReadingError, Readout
    from dataset.protocols import INDENT, PROTOCOLS, TABLE, forces
    from dataset.samples import ENOUGH, AnySamples, Samples, joined, require_dtype, require_samples
    from dataset.simulation import require_memory
    from dataset.stored import StoredSamples, in_memory, read_predictions, read_samples
    from dataset.table import TABLES, holds_samples, write_table
    from dataset.variables import ARRAYS
    from decoupler.data.columns import Columns, acting_component, component_named
    from decoupler.data.load_table import KnownLoad, read_loads, read_pairs
    from decoupler.data.pairs import Pairs
    from decoupler.data.usual_loads import usual_loads
    from decoupler.evaluation.assessment import Assessment, as_plain, assess, assess_predictions
    from decoupler.evaluation.crossval import Fold, cross_validate, over_folds, split_folds, summary
    from decoupler.evaluation.metrics import ForceErrors, evaluate as errors_on
    from decoupler.evaluation.plausibility import doubt, nothing_to_learn
    from decoupler.export import export_model
    from decoupler.inverse.posterior import Posterior
    from decoupler.model.at_strain import DecouplerAtStrain
    from decoupler.inverse.sensor_model import SensorModel
    from decoupler.model.decoupler import Decoupler
    from decoupler.model_file import read_model, require_same_sensor, write_model
    from decoupler.rubber.check import RubberCheck, checked as check_rubber, doubted
    from decoupler.rubber.fit import identified as rubber_of
    from decoupler.rubber.law import Rubber
    from decoupler.rubber.pictures import draw_rubber
    from decoupler.rubber.rubber_file import extended, read_rubber, write_rubber
    from decoupler.rubber.series import Series, read_series
    from geometry.silicones import surrounded
    from decoupler.rubber.unknown import write_test
    from decoupler.touch.assessment import TouchAssessment, assess_touch
    from decoupler.touch.bare import BareDecoder
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.touch.library import OWN_PRESSES, PRESSES, touch_library
    from decoupler.touch.plates import PlateDecoder, plate_response
    from decoupler.touch.sensing import identified_pillars
    from decoupler.readings import Pillars
    from decoupler.model.decoder import Decoder
    from decoupler.training.finite_strain import posterior_of
    from decoupler.training.suited import suited, without_stuck
    from decoupler.training.trainer import train
    from decoupler.twin.expectation import Expectation
    from decoupler.twin.identification import N_LOADS, Twin, identify
    from decoupler.twin.next_load import KITCHEN, NextLoad, loads_at_hand, next_loads
    from decoupler.twin.twin_samples import StrainedDraws
    from decoupler.twin.twin_file import TwinFile, read_twin, write_twin
    from fem.array.response import ArrayResponse, write_response
    from fem.array.sensitivities import ResponseSensitivities, response_sensitivities
    from fem.array.solving import ResponseSettings
    from fem.contact import (
        Contact, Cylinder, Flat, Shape, Solid, Sphere, about_z, at_finite_strain, judge, press, read_solid, why_tangent,
    )  # fmt: skip
    from fem.contact.shapes import TOOL_FILES
    from fem.contact.surface import require_bare, require_pressable
    from fem.methods.plan import make_plan
    from fem.kernel.newton import Stopped
    from fem.methods.solving import LARGE_SHARE, follow, small_strain_warning
    from fem.pictures.arrays import solve_array_field
    from fem.pictures.contact import draw_contact
    from fem.pictures.deformation import QUANTITIES, DeformedPicture
    from fem.pictures.parts import Parts, write_field
    from fem.pictures.pressed import Watch
    from fem.scene.scene import Scene
    from fem.scene.scene_file import read_scene
    from fem.scene.solution import Solution, solution_as_plain
    from geometry.design_file import states_twin
    from geometry.mould import write_cad
    from common.pool import open_pool, require_pool
    from hardware.boards.simulated import (
        PressAndSlide, counts_over_time, press_and_slide, run_board, suited_kind, usual_rate, write_truth,
    )  # fmt: skip
    from hardware.boards.sensor_header import sensor_header
    from hardware.boards.python_board import NO_TERMINALS
    from hardware.link.frames import Info
    from hardware.link.lines import matrix_info
    from hardware.link.reception import LinkStatistics
    from hardware.link.serial_ports import require_symlink, symlinked
    from hardware.readout.averaging import averaged, require_still
    from hardware.readout.calibration import Electronics, SensorCalibration, read_calibration, write_calibration
    from hardware.readout.crossbar import SUITED_SENSE_OHM, Crossbar, scan_mode_named
    from hardware.readout.crossbar_readout import CrossbarReadout, seen_by, shunts_of
    from hardware.readout.description import SensorDescription
    from hardware.readout.forces import Forces, LiveSensor, replay
    from hardware.readout.known_loads import calibrated
    from hardware.recording import Recording, read_recording
    from hardware.session import RECORDING_QUEUE, connect, counts_within, ended_by_signal, follows, hashes_of, live
    from hardware.session import measure_link, record_scans
    from hardware.streams.stream import LOOPBACK, Stream, host_and_port, listening_on, reachable, require_new
    from hardware.streams.files import convert, write_forces
    from hardware.streams.foxglove_stream import PORT as FOXGLOVE_PORT, FoxgloveStream
    from hardware.streams.ros2_file import ros2_stream
    from hardware.streams.rerun_stream import PORT as RERUN_PORT, RerunStream
    from serial.tools.list_ports import comports
    from tripillar.doctor import Check
    from tripillar.doctor.known_answers import KNOWN, check_answers
    from tripillar.doctor.surroundings import check_surroundings
    from tripillar.face.checks import (
        enough,
        fits,
        heed,
        joint_model,
        mention,
        require_heeded,
        response_of,
        warn_of_deviations,
        warn_of_predictions,
        warn_of_test,
    )
    from tripillar.face.measured_loads import measured_in_recording, measured_live
    from tripillar.face.tables import (
        assessed_touch_tables, assessment_table, comparison_table, contact_table, crossval_table, solution_table,
        stage_table,
    )  # fmt: skip
    from tripillar.pipeline.comparison import Comparison
    from tripillar.pipeline.manufactured import AS_READ, PAIRS
    from tripillar.pipeline.run import CAP, SPLITS, PipelineResult, run_pipeline
    from tripillar.pipeline.stage import Stage, meshed, respond
    from tripillar.datasets.finite_samples import simulate_finite
    from tripillar.datasets.leaves import LeafJob, make_directory
    from tripillar.sweeps.optimize import search
    from tripillar.sweeps.rows import Row, write_parquet
    from tripillar.sweeps.run import judge_all, kept_rows
    from tripillar.sweeps.sampling import samples_of as samples_of_sweep
    from tripillar.sweeps.sweep_file import Sweep, read_sweep
    from tripillar.sweeps.trade_offs import best_tables, draw_pareto, ranked, reasons, told, untold
    from tripillar.terminal.force_view import memory_line, print_lines, show_forces
    from tripillar.viewer.page.page import Subject
    from tripillar.viewer.page.sensing import PressedSensor, SensorFeed, inverse_forces, net_forces
    from tripillar.viewer.page.server import serve
    from tripillar.viewer.saving import FRAMES, SAVERS, save_blocks
    from tripillar.viewer.panels import is_linear, largest_mm, linear_note, panels_of, read_body, require_drawable
    from tripillar.viewer.panels import suited_scale


__getattr__ = lazily(__name__)
