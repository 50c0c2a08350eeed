//! How to read the figures: who answers, what is searched, and what the intervals leave out. The same
//! sentences stand in Markdown and on the page.

use crate::evaluation::results::{Database, Method};

/// What the intervals are, and what they take for granted.
pub(super) const INTERVALS: &str = "Intervals are Wilson's at 95 % unless the definition says otherwise. They treat \
     frames as independent; neighbouring frames are not, so the true intervals are wider.";

/// Each name in the figures with what it stands for: the methods, then the databases.
pub(super) fn names() -> Vec<(&'static str, &'static str)> {
    let methods = Method::ALL.map(|method| (method.as_str(), of_method(method)));
    let databases =
        [Database::Frames, Database::Map].map(|database| (database.as_str(), of_database(database)));
    methods.into_iter().chain(databases).collect()
}

fn of_method(method: Method) -> &'static str {
    match method {
        Method::Cnn => "the CNN alone, which compares whole images by one descriptor each",
        Method::BowHv => {
            "bag of words and Hough voting alone: local features that agree in word and geometry"
        }
        Method::CnnBowHv => "both together, as the product (loci run) decides",
    }
}

fn of_database(database: Database) -> &'static str {
    match database {
        Database::Frames => "every reference frame is searched, as the field's benchmarks do",
        Database::Map => "the map is searched that Loci founds by itself on the reference, as a robot does",
    }
}
