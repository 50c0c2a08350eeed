//! The layout that a viewer opens a recording with.
//!
//! Above, the camera with its keypoints and, twice as wide, the frame beside the matched keyframe;
//! below, places and measures over time, the current answer and the log. Side panels are folded away.

use ::rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial2DView, Tabs,
    TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical, components::PanelState,
};

use super::style;

/// The layout.
pub(super) fn blueprint() -> Blueprint {
    let pictures = Horizontal::new([
        Spatial2DView::new("Camera").with_origin(style::CAMERA_IMAGE).into(),
        Spatial2DView::new("Frame and matched keyframe")
            .with_origin("camera").with_contents(["camera/**", "- camera/image/keypoints"])
            .into(),
    ]);
    let answers = Horizontal::new([
        Vertical::new([series("Place", style::PLACE), measures()]).with_row_shares([1.0, 1.0]).into(),
        Vertical::new([
            TextDocumentView::new("Answer").with_origin(style::NOW).into(),
            TextLogView::new("Log").with_origin(style::LOG).into(),
        ])
        .with_row_shares([1.4, 1.0])
        .into(),
    ]);
    Blueprint::new(
        Vertical::new([
            pictures.with_column_shares([1.0, 2.0]).into(),
            answers.with_column_shares([1.0, 1.0]).into(),
        ])
        .with_row_shares([1.0, 1.1]),
    )
    .with_auto_views(false)
    .with_auto_layout(false)
    .with_blueprint_panel(BlueprintPanel::new().with_state(PanelState::Hidden))
    .with_selection_panel(SelectionPanel::new().with_state(PanelState::Hidden))
    .with_time_panel(TimePanel::new().with_state(PanelState::Collapsed).with_timeline(super::FRAME_TIMELINE))
}

fn measures() -> ContainerLike {
    Tabs::new([
        series("Confidence", style::CONFIDENCE),
        series("Effective inliers", style::INLIERS),
        series("Latency in ms", "latency"),
    ])
    .into()
}

fn series(name: &str, origin: &str) -> ContainerLike {
    TimeSeriesView::new(name).with_origin(origin).into()
}
