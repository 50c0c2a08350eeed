//! The layout that a viewer opens a recording with.
//!
//! Above, the camera with its keypoints and, twice as wide, the frame beside the matched keyframe. Below, from left to
//! right: where the robot is, on the map and by what is believed; why, by similarities and curves over time; and the
//! answer in words, with the log. Side panels are folded away.
//!
//! rerun's Rust layouts of 0.36 lack most properties of views, such as the part of the plane that a 2-D
//! view shows and where the legend of a plot stands. They are logged into the layout's own store here,
//! as its Python layouts do.

use ::rerun::blueprint::components::{Corner2D, PanelState, PlayState, TextLogColumn, VisualBounds2D};
use ::rerun::blueprint::datatypes::{self, TextLogColumnKind};
use ::rerun::blueprint::{
    BarChartView, Blueprint, BlueprintActivation, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel,
    Spatial2DView, Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use ::rerun::components::{self, Visible};
use ::rerun::datatypes::{Bool, Range1D, Range2D};
use ::rerun::log::LogMsg;
use ::rerun::{
    Component, ComponentBatch, ComponentDescriptor, RecordingStream, RecordingStreamBuilder,
    RecordingStreamResult, SerializedComponentBatch,
};

use super::clock::FRAME_TIMELINE;
use super::{RerunDetail, gallery, style};

/// Margin around pictures, as a share of their height.
const MARGIN: f32 = 0.02;

/// Sends the layout that `design` makes. It becomes the active one too: a viewer that is slow to load would otherwise
/// begin with a layout of its own.
pub(super) fn send(
    stream: &RecordingStream,
    design: impl FnOnce(&mut Layout) -> Blueprint,
) -> RecordingStreamResult<()> {
    let mut layout = Layout::default();
    let blueprint = design(&mut layout);
    let (carrier, messages) = RecordingStreamBuilder::new(super::APPLICATION).memory()?;
    blueprint.send(&carrier, BlueprintActivation { make_active: true, make_default: true })?;
    let (mut layout_messages, mut activation) = (Vec::new(), None);
    for message in messages.take() {
        match message {
            LogMsg::BlueprintActivationCommand(command) => activation = Some(command),
            message if message.store_id().is_blueprint() => layout_messages.push(message),
            _ => {}
        }
    }
    if let Some(activation) = activation {
        let store = RecordingStreamBuilder::from_store_id(&activation.blueprint_id).send_properties(false);
        let (store, messages) = store.memory()?;
        store.set_time_sequence("blueprint", 0);
        for (path, properties) in layout.properties {
            store.log_serialized_batches(path, false, properties)?;
        }
        layout_messages.extend(messages.take());
        stream.send_blueprint(layout_messages, activation);
    }
    Ok(())
}

/// Properties of views, by their path in the layout's store.
#[derive(Default)]
pub(super) struct Layout {
    properties: Vec<(String, Vec<SerializedComponentBatch>)>,
}

impl Layout {
    /// The layout of a run in that detail, for a camera picture and a match view of these widths and this height in
    /// pixels.
    pub(super) fn run(&mut self, detail: RerunDetail, widths_px: [f32; 2], height_px: f32) -> Blueprint {
        let camera =
            self.shows(Spatial2DView::new("Camera").with_origin("camera").into(), widths_px[0], height_px);
        let (whereabouts, reasons, words) = (self.whereabouts(), self.reasons(detail), self.words());
        let all = if detail.shows_evidence() {
            let matched = Spatial2DView::new("Frame and matched keyframe")
                .with_contents([style::CAMERA_IMAGE, "camera/images/**", "match/**"].map(str::to_owned));
            let matched = self.shows(matched.into(), widths_px[1], height_px);
            let pictures = Horizontal::new([camera, matched]).with_column_shares([1.0, 2.0]);
            let answers = Horizontal::new([whereabouts.into(), reasons, words.into()]);
            Vertical::new([pictures.into(), answers.into()]).with_row_shares([1.0, 1.25]).into()
        } else {
            let seen = Vertical::new([camera, reasons]);
            ContainerLike::from(Horizontal::new([seen.into(), whereabouts.into(), words.into()]))
        };
        // What is newest is shown, live and of a file, until somebody goes back.
        let time = TimePanel::new().with_play_state(PlayState::Following);
        tidy(all, time.with_timeline(FRAME_TIMELINE))
    }

    /// Where the robot is.
    fn whereabouts(&mut self) -> Vertical {
        let belief = BarChartView::new("Belief over places (leftmost: none of them)");
        let belief = self.with_legend(belief.with_origin(style::BELIEF).into(), None);
        let map = Spatial2DView::new("Map").with_origin(style::MAP);
        Vertical::new([map.into(), belief]).with_row_shares([1.6, 1.0])
    }

    /// Why it is thought to be there.
    fn reasons(&mut self, detail: RerunDetail) -> ContainerLike {
        let measures = Tabs::new([
            self.series("Place", style::PLACE, Some(Corner2D::LeftTop)),
            self.confidence(),
            self.series("Effective inliers", style::INLIERS, None),
            self.series("Latency in ms", "latency", Some(Corner2D::LeftTop)),
            self.series("Queues and losses", "flow", Some(Corner2D::LeftTop)),
        ]);
        if !detail.shows_evidence() {
            return measures.into();
        }
        let similarity = Spatial2DView::new("Similarity of frames (right) to keyframes (down)");
        Vertical::new([similarity.with_origin(style::SIMILARITY).into(), measures.into()]).into()
    }

    /// The answer, and those before it.
    fn words(&mut self) -> Vertical {
        let log = self.log(TextLogView::new("Log").with_origin(style::LOG).into());
        let answer = TextDocumentView::new("Answer").with_origin(style::NOW);
        Vertical::new([answer.into(), log]).with_row_shares([1.3, 1.0])
    }

    /// The layout of a run's review, with pictures of the map or without.
    pub(super) fn logged(&mut self, has_pictures: bool) -> Blueprint {
        let picture = |name: &str, origin: &str| Spatial2DView::new(name).with_origin(origin).into();
        let map = Spatial2DView::new("Map").with_origin(style::MAP).into();
        let seen = if has_pictures {
            let pictures = Vertical::new([
                picture("Frame, as it was learnt", style::EXPERIENCE),
                picture("Matched keyframe", style::KEYFRAME),
            ]);
            ContainerLike::from(Horizontal::new([pictures.into(), map]).with_column_shares([1.0, 1.3]))
        } else {
            map
        };
        let place = self.series("Place", style::PLACE, Some(Corner2D::LeftTop));
        let curves = Tabs::new([
            self.confidence(),
            self.series("Effective inliers", style::INLIERS, None),
            self.series("Latency in ms", "latency", Some(Corner2D::LeftTop)),
            self.series("Queues and losses", "flow", Some(Corner2D::LeftTop)),
        ]);
        let run = Vertical::new([seen, Horizontal::new([place, curves.into()]).into()]);
        let all = Horizontal::new([run.with_row_shares([1.6, 1.0]).into(), self.words().into()]);
        let time = TimePanel::new().with_play_state(PlayState::Paused);
        tidy(all.with_column_shares([2.0, 1.0]), time.with_timeline(FRAME_TIMELINE))
    }

    /// The layout of a map's review: places on one tab, all experiences on the other.
    pub(super) fn review(&mut self) -> Blueprint {
        let [width, height] = gallery::SHEET;
        let sheet =
            Spatial2DView::new("Experiences of the place, keyframes framed").with_origin(style::GALLERY);
        let words = Vertical::new([
            TextDocumentView::new("Place").with_origin(style::NOW).into(),
            Spatial2DView::new("Map").with_origin(style::MAP).into(),
        ]);
        let above = Horizontal::new([self.shows(sheet.into(), width, height), words.into()]);
        let below = Horizontal::new([
            self.series("Experiences and keyframes, place by place", style::COUNTS, Some(Corner2D::LeftTop)),
            self.series("Mean luminance, place by place", style::LIGHT, Some(Corner2D::LeftTop)),
            self.log(TextLogView::new("Worth a look").with_origin(style::LOG).into()),
        ]);
        let places = Vertical::new([
            above.with_column_shares([1.7, 1.0]).into(),
            below.with_column_shares([1.0, 1.0, 1.4]).into(),
        ]);
        let experience = Spatial2DView::new("Experience").with_origin(style::EXPERIENCE).into();
        let experiences = Vertical::new([
            experience,
            self.series("Place of the experience", style::EXPERIENCE_PLACE, None),
        ]);
        let named = |container: Vertical, name: &str| container.with_name(name).into();
        let tabs = Tabs::new([
            named(places.with_row_shares([2.0, 1.0]), "Places (timeline: place)"),
            named(experiences, "All experiences (timeline: experience)"),
        ]);
        let time = TimePanel::new().with_play_state(PlayState::Paused);
        tidy(tabs, time.with_timeline(super::review::PLACE_TIMELINE))
    }

    /// Pictures stand still whatever is drawn on them.
    fn shows(&mut self, view: ContainerLike, width_px: f32, height_px: f32) -> ContainerLike {
        let margin = f64::from(MARGIN * height_px);
        let range = |side: f32| Range1D([-margin, f64::from(side) + margin]);
        let bounds = VisualBounds2D(Range2D { x_range: range(width_px), y_range: range(height_px) });
        self.set(&view, "VisualBounds2D", [property("VisualBounds2D:range", &[bounds])]);
        view
    }

    /// A single curve, named by its tab, needs no legend.
    fn series(&mut self, name: &str, origin: &str, legend: Option<Corner2D>) -> ContainerLike {
        self.with_legend(TimeSeriesView::new(name).with_origin(origin).into(), legend)
    }

    /// The same view, with a legend in that corner or none.
    fn with_legend(&mut self, view: ContainerLike, legend: Option<Corner2D>) -> ContainerLike {
        let visible = Visible(Bool(legend.is_some()));
        self.set(
            &view,
            "PlotLegend",
            [
                property("PlotLegend:visible", &[visible]),
                property("PlotLegend:corner", &[legend.unwrap_or_default()]),
            ],
        );
        view
    }

    fn confidence(&mut self) -> ContainerLike {
        let view = self.series("Confidence", style::CONFIDENCE, None);
        // A little above 1, so that the curve does not hide in the frame.
        let range = components::Range1D(Range1D([0.0, 1.05]));
        self.set(&view, "ScalarAxis", [property("ScalarAxis:range", &[range])]);
        view
    }

    /// All lines are of one entity.
    fn log(&mut self, view: ContainerLike) -> ContainerLike {
        let column = |kind, visible| TextLogColumn(datatypes::TextLogColumn { visible: Bool(visible), kind });
        let columns = [
            column(TextLogColumnKind::EntityPath, false),
            column(TextLogColumnKind::LogLevel, true),
            column(TextLogColumnKind::Body, true),
        ];
        self.set(&view, "TextLogColumns", [property("TextLogColumns:text_log_columns", &columns)]);
        view
    }

    fn set<const N: usize>(
        &mut self,
        view: &ContainerLike,
        archetype: &str,
        properties: [Option<SerializedComponentBatch>; N],
    ) {
        if let ContainerLike::View(view) = view {
            let path = format!("{}/{archetype}", view.blueprint_path());
            self.properties.push((path, properties.into_iter().flatten().collect()));
        }
    }
}

/// A layout without panels at its sides.
fn tidy(all: impl Into<ContainerLike>, time: TimePanel) -> Blueprint {
    Blueprint::new(all)
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::new().with_state(PanelState::Hidden))
        .with_selection_panel(SelectionPanel::new().with_state(PanelState::Hidden))
        .with_time_panel(time.with_state(PanelState::Collapsed))
}

/// `component` is `Archetype:property`, as rerun names them.
fn property<C: Component>(component: &'static str, values: &[C]) -> Option<SerializedComponentBatch>
where
    [C]: ComponentBatch,
{
    let (archetype, component_type) = (None, Some(C::name()));
    values.serialized(ComponentDescriptor { archetype, component: component.into(), component_type })
}
