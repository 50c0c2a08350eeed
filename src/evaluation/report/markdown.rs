//! The same report as text: each experiment with one row a method and database, and what varies from
//! run to run in one table of its own, so that two reports can be compared line by line.

use super::cells::{self, NOTHING};
use super::palette;
use super::text::{markdown as escape, markdown_block, markdown_code as code, wrap};
use crate::evaluation::results::{
    Asset, Baseline, Experiment, MethodResult, PaperProtocol, Report, TraverseSummary,
};

/// Where the numbers of a table stand in their cells.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Align {
    Left,
    /// All columns but the first.
    Right,
}

/// The whole document.
pub(super) fn document(report: &Report) -> String {
    let mut parts = vec![
        "# Loci evaluation\n".to_owned(),
        "Made by this command:\n".to_owned(),
        markdown_block(&report.header.command),
        header(report),
        paragraph(
            "Cells read `rate [low, high] n`: the rate, its 95 % interval (Wilson's unless the definition says \
             otherwise) and what was counted. What each figure means stands at the end.",
        ),
    ];
    parts.extend(report.experiments.iter().map(experiment));
    parts.push(definitions(report));
    parts.extend(settings(report));
    parts.join("\n")
}

fn paragraph(prose: &str) -> String {
    wrap("", "", prose)
}

fn item(prose: &str) -> String {
    wrap("- ", "  ", prose)
}

fn header(report: &Report) -> String {
    let header = &report.header;
    let asset = |asset: &Asset| format!("{}, SHA-256 {}", code(&asset.name), code(&asset.sha256));
    let rows = [
        ("Loci", escape(&header.loci)),
        ("Processor", escape(&header.cpu)),
        ("Hardware threads", cells::thousands(header.cpu_threads as u64)),
        ("Backend", escape(&header.backend)),
        ("Vocabulary", asset(&header.vocabulary)),
        ("CNN", header.model.as_ref().map_or_else(|| NOTHING.to_owned(), asset)),
        ("Schema", code(report.schema)),
    ];
    let rows: Vec<Vec<String>> = rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect();
    table(&["What", "Which"], &rows, Align::Left)
}

fn experiment(experiment: &Experiment) -> String {
    let mut parts = vec![format!("## {}\n", escape(&experiment.name))];
    parts.extend(experiment.note.as_deref().map(|note| paragraph(&escape(note))));
    parts.push(question(experiment));
    parts.extend(warnings(&experiment.warnings));
    parts.push(figures(experiment));
    let baseline = |baseline: &Baseline| {
        item(&format!("Baseline {}: {}", escape(&baseline.method), escape(&baseline.figure)))
    };
    let baselines: String = experiment.baselines.iter().map(baseline).collect();
    parts.extend(Some(baselines).filter(|list| !list.is_empty()));
    parts.extend(experiment.paper.as_ref().map(paper));
    parts.extend(timing(experiment));
    parts.join("\n")
}

/// A quotation, which stands apart from the lists around it.
fn warnings(warnings: &[String]) -> Option<String> {
    let list: String = warnings.iter().map(|warning| wrap("> - ", ">   ", &escape(warning))).collect();
    (!list.is_empty()).then(|| format!("> **Warning**, what makes these figures doubtful:\n>\n{list}"))
}

fn question(experiment: &Experiment) -> String {
    let traverse = |role: &str, traverse: &TraverseSummary| {
        let skipped = match traverse.skipped {
            0 => String::new(),
            skipped => format!(", {} more could not be read", cells::thousands(skipped)),
        };
        let frames = cells::thousands(traverse.frames);
        item(&format!("{role}: {}, {frames} frames{skipped}", code(&traverse.name)))
    };
    let own_past = || item("Reference: the query's own past");
    let mut list = experiment.reference.as_ref().map_or_else(own_past, |known| traverse("Reference", known));
    list += &traverse("Query", &experiment.query);
    list +=
        &experiment.unknown.as_ref().map_or_else(String::new, |unknown| traverse("Unknown places", unknown));
    let truth = &experiment.ground_truth;
    let hash = truth.sha256.as_ref().map_or_else(String::new, |hash| format!(" (SHA-256 {})", code(hash)));
    list += &item(&format!("Ground truth{hash}: {}", escape(&truth.definition)));
    let [known, unknown, unscored] = [truth.known, truth.unknown, truth.unscored].map(cells::thousands);
    list + &item(&format!(
        "Scored query frames: {known} of known places, {unknown} of unknown ones; {unscored} not scored"
    ))
}

fn figures(experiment: &Experiment) -> String {
    let columns = cells::columns_in_use(&experiment.results);
    if columns.is_empty() {
        return paragraph("Nothing was counted.");
    }
    let mut head = vec!["Method · database"];
    head.extend(columns.iter().map(|column| column.title));
    let row = |result: &MethodResult| {
        let mut row = vec![palette::label(result)];
        row.extend(columns.iter().map(|column| cells::line((column.cell)(&result.figures).as_ref())));
        row
    };
    let rows: Vec<Vec<String>> = experiment.results.iter().map(row).collect();
    table(&head, &rows, Align::Left)
}

fn paper(paper: &PaperProtocol) -> String {
    let published = paper.published;
    let percent = |percent: f64| format!("{} ({percent} %)", cells::decimal(percent / 100.0));
    let rows = [
        vec![
            "Loci".to_owned(),
            cells::proportion(paper.cnn.as_ref()),
            cells::proportion(paper.bow_hv.as_ref()),
            format!("{} / {}", cells::thousands(paper.clusters_founded), cells::thousands(paper.classes)),
            cells::proportion(paper.training_share.as_ref()),
            escape(&paper.classifier),
        ],
        vec![
            format!("Paper: {}", escape(published.traverse)),
            percent(published.cnn_percent),
            percent(published.bow_hv_percent),
            format!("{NOTHING} / {}", published.classes),
            percent(published.training_percent),
            NOTHING.to_owned(),
        ],
    ];
    let head = ["Whose", "CNN", "BoW+HV", "Clusters / classes", "Training frames in classes", "Classifier"];
    let prose = "The paper's protocol: clusters of one traverse train a classifier that rates another; every frame \
                 is answered, and there is no unknown class.";
    format!("{}\n{}", paragraph(prose), table(&head, &rows, Align::Left))
}

fn timing(experiment: &Experiment) -> Option<String> {
    let nothing = || NOTHING.to_owned();
    let mut rows: Vec<Vec<String>> = experiment
        .latency
        .iter()
        .map(|stage| {
            let [p50, p90, p99] = [stage.p50_us, stage.p90_us, stage.p99_us].map(cells::milliseconds);
            vec![escape(stage.stage), p50, p90, p99, nothing(), "ms".to_owned(), cells::thousands(stage.n)]
        })
        .collect();
    if let Some(bytes) = experiment.peak_memory_bytes {
        let peak = cells::mebibytes(bytes);
        let name = "memory, evaluation included".to_owned();
        rows.push(vec![name, nothing(), nothing(), nothing(), peak, "MiB".to_owned(), nothing()]);
    }
    if rows.is_empty() {
        return None;
    }
    let table = table(&["Stage", "p50", "p90", "p99", "Peak", "Unit", "n"], &rows, Align::Right);
    Some(format!("Timing (varies from run to run):\n\n{table}"))
}

fn definitions(report: &Report) -> String {
    let list: String = cells::COLUMNS
        .iter()
        .map(|column| item(&format!("**{}**: {}", column.title, escape(&column.definition(report)))))
        .collect();
    format!("## What the figures mean\n\n{list}")
}

fn settings(report: &Report) -> Option<String> {
    let rows: Vec<Vec<String>> =
        report.header.settings.iter().map(|(name, value)| vec![code(name), code(value)]).collect();
    (!rows.is_empty()).then(|| format!("## Settings\n\n{}", table(&["Setting", "Value"], &rows, Align::Left)))
}

/// A table whose columns are padded to one width, so that it reads as text too.
fn table(head: &[&str], rows: &[Vec<String>], align: Align) -> String {
    let width_of = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([head[column].chars().count(), 3]).max().unwrap_or(3)
    };
    let widths: Vec<usize> = (0..head.len()).map(width_of).collect();
    let is_right = |column: usize| align == Align::Right && column > 0;
    let line = |cells: &[&str]| {
        let padded: Vec<String> = widths
            .iter()
            .enumerate()
            .map(|(column, &width)| {
                let cell = cells.get(column).copied().unwrap_or(NOTHING);
                if is_right(column) { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            })
            .collect();
        format!("| {} |\n", padded.join(" | "))
    };
    let rules: Vec<String> = widths
        .iter()
        .enumerate()
        .map(
            |(column, &width)| if is_right(column) { "-".repeat(width - 1) + ":" } else { "-".repeat(width) },
        )
        .collect();
    let mut table = line(head) + &line(&rules.iter().map(String::as_str).collect::<Vec<_>>());
    for row in rows {
        table += &line(&row.iter().map(String::as_str).collect::<Vec<_>>());
    }
    table
}
