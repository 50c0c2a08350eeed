//! The page: head, all at a glance, how it was made, contents, how to read it, the experiments, what the
//! figures mean, the settings.

use std::fmt::Write as _;

use super::text::html as escape;
use super::{ReportError, cells, experiment, glance, reading};
use crate::evaluation::results::{Asset, Header, Report};

const STYLE: &str = include_str!("style.css");

/// Nothing may be loaded from anywhere, whatever stands in the data.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

/// The whole document.
pub(super) fn document(report: &Report) -> Result<String, ReportError> {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n\
         <title>Loci evaluation</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n"
    );
    let command = escape(&report.header.command);
    let _ = write!(
        page,
        "<header>\n<h1>Loci evaluation</h1>\n<p>Made by this command:</p>\n\
         <pre class=\"command\"><code>{command}</code></pre>\n</header>\n"
    );
    page += &at_a_glance(report);
    page += &header(report);
    page += &contents(report);
    page += &how_to_read();
    for (index, experiment) in report.experiments.iter().enumerate() {
        page += &experiment::section(report, experiment, index + 1)?;
    }
    page += &definitions(report);
    page += &settings(&report.header);
    page += "</main>\n</body>\n</html>\n";
    Ok(page)
}

fn at_a_glance(report: &Report) -> String {
    let mut rows = Vec::new();
    for (index, row) in glance::rows(report).iter().enumerate() {
        let experiment = row.experiment;
        let stand_in = row.stand_in.as_ref().map_or_else(String::new, |which| part(which));
        let link =
            format!("<a href=\"#experiment-{}\">{}</a>{stand_in}", index + 1, escape(&experiment.name));
        let mut cells = vec![link, row.frames.clone()];
        cells.extend(row.figures.iter().map(|figure| match figure {
            Some((rate, counts)) => format!("<strong>{rate}</strong>{}", part(&format!("({counts})"))),
            None => cells::NOTHING.to_owned(),
        }));
        rows.push(cells);
    }
    if rows.is_empty() {
        return String::new();
    }
    let table = table("The product’s decision in every experiment", &glance::HEAD, &rows)
        .replace("<table>", "<table class=\"numbers\">");
    let sentence = escape(glance::SENTENCE);
    format!("<section>\n<h2 id=\"glance\">At a glance</h2>\n<p>{sentence}</p>\n{table}</section>\n")
}

/// What is said in small below a figure or a name.
pub(super) fn part(words: &str) -> String {
    format!("<span class=\"part\">{}</span>", escape(words))
}

fn how_to_read() -> String {
    let mut section =
        "<section>\n<h2 id=\"reading\">How to read the figures</h2>\n<dl class=\"names\">\n".to_owned();
    for (name, meaning) in reading::names() {
        let _ = writeln!(section, "<dt><code>{}</code></dt>\n<dd>{}</dd>", escape(name), typeset(meaning));
    }
    let intervals = typeset(reading::INTERVALS);
    section + &format!("</dl>\n<p>{intervals} n is what was counted.</p>\n</section>\n")
}

/// Our own prose with the apostrophes of print.
fn typeset(prose: &str) -> String {
    escape(&prose.replace('\'', "’"))
}

fn header(report: &Report) -> String {
    let header = &report.header;
    let vocabularies: Vec<String> = header.vocabularies.iter().map(|known| asset(Some(known))).collect();
    let mut rows = vec![
        vec!["Loci".to_owned(), escape(&header.loci)],
        vec!["Processor".to_owned(), escape(&header.cpu)],
        vec!["Hardware threads".to_owned(), cells::thousands(header.cpu_threads as u64)],
        vec!["Backend".to_owned(), escape(&header.backend)],
        vec!["Vocabulary".to_owned(), vocabularies.join("; ")],
        vec!["CNN".to_owned(), asset(header.model.as_ref())],
    ];
    rows.extend(header.suite.as_ref().map(|suite| vec!["Suite".to_owned(), asset(Some(suite))]));
    if !header.settings.is_empty() {
        let count = cells::thousands(header.settings.len() as u64);
        rows.push(vec!["Settings".to_owned(), format!("<a href=\"#settings\">{count}, at the end</a>")]);
    }
    rows.push(vec!["Schema".to_owned(), format!("<code>{}</code>", escape(report.schema))]);
    let table = table("Program, machine and files", &[], &rows);
    format!("<section>\n<h2 id=\"made\">How these figures were made</h2>\n{table}</section>\n")
}

fn asset(asset: Option<&Asset>) -> String {
    asset.map_or_else(
        || cells::NOTHING.to_owned(),
        |asset| {
            format!(
                "{} <span class=\"hash\">SHA-256 <code>{}</code></span>",
                escape(&asset.name),
                escape(&asset.sha256)
            )
        },
    )
}

fn contents(report: &Report) -> String {
    let mut list = "<nav aria-labelledby=\"contents\">\n<h2 id=\"contents\">Contents</h2>\n<ol>\n\
                    <li><a href=\"#reading\">How to read the figures</a></li>\n"
        .to_owned();
    for (index, experiment) in report.experiments.iter().enumerate() {
        let warnings = match experiment.warnings.len() {
            0 => String::new(),
            1 => " <span class=\"quiet\">(1 warning)</span>".to_owned(),
            count => format!(" <span class=\"quiet\">({count} warnings)</span>"),
        };
        let name = escape(&experiment.name);
        let _ = writeln!(list, "<li><a href=\"#experiment-{}\">{name}</a>{warnings}</li>", index + 1);
    }
    list += "<li><a href=\"#definitions\">What the figures mean</a></li>\n";
    if !report.header.settings.is_empty() {
        list += "<li><a href=\"#settings\">Settings</a></li>\n";
    }
    list + "</ol>\n</nav>\n"
}

fn definitions(report: &Report) -> String {
    let mut list = "<section>\n<h2 id=\"definitions\">What the figures mean</h2>\n<dl>\n".to_owned();
    for measure in &cells::MEASURES {
        let terms: Vec<String> = measure.keys.iter().map(|key| format!("<code>{key}</code>")).collect();
        let _ = writeln!(
            list,
            "<dt>{} <span class=\"quiet\">{}</span></dt>\n<dd>{}</dd>",
            escape(measure.title),
            terms.join(", "),
            escape(&measure.definition(report))
        );
    }
    list + "</dl>\n</section>\n"
}

fn settings(header: &Header) -> String {
    if header.settings.is_empty() {
        return String::new();
    }
    let row = |(name, value): (&String, &String)| {
        vec![format!("<code>{}</code>", escape(name)), format!("<code>{}</code>", escape(value))]
    };
    let rows: Vec<Vec<String>> = header.settings.iter().map(row).collect();
    let table = table("Settings that bear on a decision", &["Setting", "Value"], &rows);
    format!("<section>\n<h2 id=\"settings\">Settings</h2>\n{table}</section>\n")
}

/// A table of cells that are HTML already; the first of each row is its head.
pub(super) fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    let mut table =
        format!("<div class=\"scroll\" tabindex=\"0\">\n<table>\n<caption>{}</caption>\n", escape(caption));
    if !head.is_empty() {
        let heads: Vec<String> =
            head.iter().map(|title| format!("<th scope=\"col\">{}</th>", escape(title))).collect();
        let _ = writeln!(table, "<thead>\n<tr>{}</tr>\n</thead>", heads.concat());
    }
    table += "<tbody>\n";
    for row in rows {
        table += "<tr>";
        for (index, cell) in row.iter().enumerate() {
            let _ = match index {
                0 => write!(table, "<th scope=\"row\">{cell}</th>"),
                _ => write!(table, "<td>{cell}</td>"),
            };
        }
        table += "</tr>\n";
    }
    table + "</tbody>\n</table>\n</div>\n"
}
