//! The same report as text: each experiment with a column a method and database, and what varies from
//! run to run in one table of its own, so that two reports can be compared line by line.

use super::cells::{self, NOTHING};
use super::text::{markdown as escape, markdown_block, markdown_code as code, wrap};
use super::{glance, palette, reading};
use crate::evaluation::results::{Asset, Baseline, Experiment, PaperProtocol, Report, TraverseSummary};

/// Headings that this document has anyway.
const OWN_HEADINGS: [&str; 6] = [
    "Loci evaluation",
    "At a glance",
    "How these figures were made",
    "How to read the figures",
    "What the figures mean",
    "Settings",
];

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
    ];
    parts.extend(at_a_glance(report));
    parts.push(header(report));
    parts.push(how_to_read());
    parts.extend(report.experiments.iter().map(experiment));
    parts.push(definitions(report));
    parts.extend(settings(report));
    parts.join("\n")
}

fn at_a_glance(report: &Report) -> Option<String> {
    let row = |row: &glance::Row<'_>| {
        let experiment = row.experiment;
        let name = escape(&experiment.name);
        let linked = match anchor(report, &experiment.name) {
            Some(anchor) => format!("[{name}](#{anchor})"),
            None => name,
        };
        let stand_in = row.stand_in.as_ref().map_or_else(String::new, |which| format!(" ({which})"));
        let mut cells = vec![format!("{linked}{stand_in}"), row.frames.clone()];
        cells.extend(row.figures.iter().map(|figure| match figure {
            Some((rate, counts)) => format!("{rate} ({counts})"),
            None => NOTHING.to_owned(),
        }));
        cells
    };
    let rows: Vec<Vec<String>> = glance::rows(report).iter().map(row).collect();
    let table = || table(&glance::HEAD, &rows, Align::Right);
    (!rows.is_empty()).then(|| format!("## At a glance\n\n{}\n{}", paragraph(glance::SENTENCE), table()))
}

/// Where GitHub puts the heading: in small letters, blanks as hyphens, without punctuation. Only plain names,
/// for which that is certain, and which no other heading shares, get a link.
fn anchor(report: &Report, name: &str) -> Option<String> {
    let is_kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    let slug = |heading: &str| {
        let kept: String = heading.chars().filter(is_kept).collect();
        kept.to_lowercase().replace(' ', "-")
    };
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, ' ' | ',' | '-');
    let is_certain =
        !name.is_empty() && name.chars().all(is_plain) && !name.contains("  ") && name.trim() == name;
    let headings = report.experiments.iter().map(|experiment| experiment.name.as_str()).chain(OWN_HEADINGS);
    let is_alone = || headings.filter(|heading| slug(heading) == slug(name)).count() == 1;
    (is_certain && is_alone()).then(|| slug(name))
}

fn how_to_read() -> String {
    let cells = paragraph(
        "In the figures, a column is a method and a database. Cells read `rate [low, high] n`: the rate, its interval \
         and what was counted; n stands at the head of the row where it is the same for all.",
    );
    let names: String = reading::names()
        .iter()
        .map(|(name, meaning)| item(&format!("{}: {}", code(name), escape(meaning))))
        .collect();
    let intervals = paragraph(&format!("{} What each figure means stands at the end.", reading::INTERVALS));
    format!("## How to read the figures\n\n{cells}\n{names}\n{intervals}")
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
    let mut rows = vec![
        ("Loci", escape(&header.loci)),
        ("Processor", escape(&header.cpu)),
        ("Hardware threads", cells::thousands(header.cpu_threads as u64)),
        ("Backend", escape(&header.backend)),
        ("Vocabulary", header.vocabularies.iter().map(asset).collect::<Vec<_>>().join("; ")),
        ("CNN", header.model.as_ref().map_or_else(|| NOTHING.to_owned(), asset)),
    ];
    rows.extend(header.suite.as_ref().map(|suite| ("Suite", asset(suite))));
    rows.push(("Schema", code(report.schema)));
    let rows: Vec<Vec<String>> = rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect();
    format!("## How these figures were made\n\n{}", table(&["What", "Which"], &rows, Align::Left))
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
    let setting = |(name, value): (&String, &String)| format!("{} {}", code(name), code(value));
    let settings: Vec<String> = experiment.settings.iter().map(setting).collect();
    if !settings.is_empty() {
        list += &item(&format!("Settings: {}", settings.join(", ")));
    }
    let [known, unknown, unscored] = [truth.known, truth.unknown, truth.unscored].map(cells::thousands);
    list + &item(&format!(
        "Scored query frames: {known} of known places, {unknown} of unknown ones; {unscored} not scored"
    ))
}

fn figures(experiment: &Experiment) -> String {
    let results = &experiment.results;
    let measures = cells::measures_in_use(results);
    if measures.is_empty() {
        return paragraph("Nothing was counted.");
    }
    let labels: Vec<String> = results.iter().map(palette::label).collect();
    let head: Vec<&str> = std::iter::once("Figure").chain(labels.iter().map(String::as_str)).collect();
    let row = |measure: &&cells::Measure| {
        let (figures, shared_n) = measure.row(results);
        let counted = shared_n.map_or_else(String::new, |n| format!(" (n {})", cells::thousands(n)));
        let title = format!("{}{counted}", measure.title);
        std::iter::once(title).chain(figures.iter().map(|cell| cells::line(cell.as_ref()))).collect()
    };
    let rows: Vec<Vec<String>> = measures.iter().map(row).collect();
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
    let list: String = cells::MEASURES
        .iter()
        .map(|measure| item(&format!("**{}**: {}", measure.title, escape(&measure.definition(report)))))
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
