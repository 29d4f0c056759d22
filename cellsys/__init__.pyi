from . import bondgraph, response
from .bondgraph import BondGraph
from .errors import (
    BudgetError,
    CausalityError,
    CellsysError,
    DataError,
    DimensionError,
    FileFormatError,
    IntegrationError,
    MissingExtraError,
    NotSymbolicError,
    ParameterError,
    RankError,
    RepresentationError,
    SceneError,
    UnitError,
)
from .integrate import (
    CVODES,
    DOP853,
    LSODA,
    ExplicitEuler,
    LinearlyImplicit,
    Radau,
    RungeKutta4,
    simulate,
    stability_limit,
)
from .loop import (
    ClosedLoop,
    MPol,
    Perturb,
    PolarityLaw,
    Stay,
    closed_loop,
)
from .mechanics.commands import Commands, History
from .mechanics.crawler import Crawler, CrawlerSystem, build_crawlers
from .mechanics.crawler_run import CrawlRun, crawl
from .observe import contact_radius, node_speed, summary_of_run
from .population import (
    CoupledCells,
    CoupledStability,
    Feedback,
    ForceMap,
    InteractionGraph,
    MappedSuperposition,
    P_c,
    P_F_phi,
    P_phi,
    PoleSet,
    Superposition,
    couple,
    fit_P_map,
)
from .reduction import (
    PCR,
    Basis,
    Card,
    ExactSVD,
    FullField,
    GalerkinField,
    LatentModel,
    LeastSquares,
    PoleCertainty,
    RandomisedSVD,
    Ridge,
    RunData,
    Snapshots,
    StiffnessSensor,
    assess,
    fit_basis,
    fit_sensor,
    full_field,
    pole_certainty,
    reduce,
    reduce_orders,
    snapshots,
)
from .response import (
    Realization,
    RootSet,
    Tustin,
    ZeroOrderHold,
    balanced_truncation,
    c2d,
    controllability_gramian,
    d2c,
    damping,
    error_system,
    forced_response,
    frequency_response,
    h2_norm,
    hankel_singular_values,
    hinf_norm,
    impulse_response,
    margins,
    norm,
    observability_gramian,
    participation,
    poles,
    pseudospectra,
    pseudospectral_abscissa,
    realization,
    root_locus,
    sensitivity,
    stability,
    step_response,
    zeros,
)
from .scene import (
    Scene,
    build,
    load_scene,
    run_ensemble,
    run_scene,
    scene_schema,
    training_scenes,
    turning_scenes,
)
from .study import study
from .system import (
    Block,
    Event,
    EventFunction,
    Layout,
    OdeSystem,
    OverdampedSystem,
)
from .trajectory import Trajectory
from .units import quantity
from .version import __version__
