//! A CPU budget: how much processor time the whole program may take, and whether the next frame still fits into it.

use std::num::NonZero;
use std::str::FromStr;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use serde::Deserialize;

/// How much may be saved up, so that one dear frame does not stop the next cheap ones.
const SAVED: Duration = Duration::from_millis(500);
/// How much may be owed: what had nothing to do with frames is not paid for by their want for long.
const OWED: Duration = Duration::from_secs(5);
/// After so long a frame is looked at whatever it costs.
const LONGEST_BLINDNESS: Duration = Duration::from_secs(2);
/// Fewest and most cores of a budget.
const CORES: std::ops::RangeInclusive<f64> = 0.01..=1024.0;

/// Processor time a second, in cores.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(try_from = "String")]
pub struct CpuBudget {
    cores: f64,
}

impl CpuBudget {
    /// Threads of the CNN that fit into it: one core is for everything else, where there is more than one.
    #[must_use]
    pub fn cnn_threads(self) -> NonZero<u32> {
        NonZero::new(self.cores as u32 - u32::from(self.cores >= 2.0)).unwrap_or(NonZero::<u32>::MIN)
    }
}

/// Why a text is no budget.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a share of one core such as 50%, or cores such as 1.5, got '{0}'")]
pub struct BudgetError(String);

impl TryFrom<String> for CpuBudget {
    type Error = BudgetError;

    fn try_from(text: String) -> Result<Self, BudgetError> {
        text.parse()
    }
}

impl FromStr for CpuBudget {
    type Err = BudgetError;

    fn from_str(text: &str) -> Result<Self, BudgetError> {
        let (number, unit) = match text.strip_suffix('%') {
            Some(percent) => (percent, 100.0),
            None => (text, 1.0),
        };
        let cores = number.trim().parse::<f64>().ok().map(|number| number / unit);
        let cores = cores.filter(|cores| CORES.contains(cores));
        cores.map(|cores| Self { cores }).ok_or_else(|| BudgetError(text.to_owned()))
    }
}

/// Keeps account of processor time.
#[derive(Debug)]
pub(super) struct Pace {
    account: Account,
    seen_at: Instant,
    seen_cpu: Duration,
    looked_at: Instant,
}

impl Pace {
    /// An account that begins now.
    pub(super) fn new(budget: CpuBudget) -> Self {
        let now = Instant::now();
        Self { account: Account::new(budget), seen_at: now, seen_cpu: cpu_time(), looked_at: now }
    }

    /// How long to wait until another frame is looked at; zero if this one is.
    pub(super) fn wait(&mut self) -> Duration {
        let (now, cpu) = (Instant::now(), cpu_time());
        self.account.book(now - self.seen_at, cpu.saturating_sub(self.seen_cpu));
        (self.seen_at, self.seen_cpu) = (now, cpu);
        let wait = self.account.wait().min(LONGEST_BLINDNESS.saturating_sub(now - self.looked_at));
        if wait.is_zero() {
            self.looked_at = now;
        }
        wait
    }
}

/// Processor time that all threads of this program took so far.
fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}

/// What was taken beyond the budget, in seconds of processor time; negative where some is saved up.
#[derive(Debug)]
struct Account {
    cores: f64,
    debt_seconds: f64,
}

impl Account {
    fn new(budget: CpuBudget) -> Self {
        Self { cores: budget.cores, debt_seconds: 0.0 }
    }

    /// So much time went by, and so much processor time was taken in it.
    fn book(&mut self, passed: Duration, taken: Duration) {
        let debt = self.debt_seconds + taken.as_secs_f64() - self.cores * passed.as_secs_f64();
        self.debt_seconds = debt.clamp(-self.cores * SAVED.as_secs_f64(), self.cores * OWED.as_secs_f64());
    }

    fn wait(&self) -> Duration {
        Duration::try_from_secs_f64(self.debt_seconds / self.cores).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(text: &str) -> CpuBudget {
        text.parse().unwrap()
    }

    #[test]
    fn a_budget_is_a_share_of_a_core_or_a_number_of_cores() {
        assert_eq!(budget("50%"), CpuBudget { cores: 0.5 });
        assert_eq!(budget("150 %"), budget("1.5"));
        for text in ["", "%", "0", "-1", "nan", "inf", "5000000%", "half"] {
            let error = text.parse::<CpuBudget>().unwrap_err();
            assert!(error.to_string().ends_with(&format!("got '{text}'")), "{error}");
        }
    }

    #[test]
    fn the_cnn_gets_what_one_core_for_the_rest_leaves() {
        let threads = |text| budget(text).cnn_threads().get();
        assert_eq!(["10%", "1", "1.9", "2", "3.5", "8"].map(threads), [1, 1, 1, 1, 2, 7]);
    }

    #[test]
    fn frames_that_cost_more_than_the_budget_come_as_seldom_as_it_takes() {
        // Each takes 40 ms of processor time; half a core pays for 12.5 of them a second.
        let mut account = Account::new(budget("50%"));
        let (cost, step) = (Duration::from_millis(40), Duration::from_millis(1));
        let mut frames = 0;
        for _ in 0..100_000 {
            let is_due = account.wait().is_zero();
            frames += u32::from(is_due);
            account.book(step, if is_due { cost } else { Duration::ZERO });
        }
        assert!((1245..=1255).contains(&frames), "{frames}");
    }

    #[test]
    fn little_is_saved_up_while_nothing_comes() {
        let mut account = Account::new(budget("1"));
        account.book(Duration::from_secs(3600), Duration::ZERO);
        account.book(Duration::ZERO, Duration::from_secs(1));
        assert_eq!(account.wait(), Duration::from_millis(500));
    }

    #[test]
    fn what_this_program_computes_is_booked() {
        let mut pace = Pace::new(budget("1%"));
        let started = cpu_time();
        let mut sum = 0_u64;
        while cpu_time() - started < Duration::from_millis(50) {
            sum = std::hint::black_box(sum + 1);
        }
        let wait = pace.wait();
        assert!(wait > Duration::from_secs(1) && wait <= LONGEST_BLINDNESS, "{wait:?}");
    }

    #[test]
    fn a_debt_is_forgotten_after_a_while() {
        let mut account = Account::new(budget("50%"));
        account.book(Duration::ZERO, Duration::from_secs(1000));
        assert_eq!(account.wait(), OWED);
        account.book(OWED, Duration::ZERO);
        assert_eq!(account.wait(), Duration::ZERO);
    }

    #[test]
    fn a_robot_is_never_blind_for_long() {
        let mut pace = Pace::new(budget("1%"));
        pace.account.book(Duration::ZERO, Duration::from_secs(1000));
        pace.looked_at = Instant::now().checked_sub(LONGEST_BLINDNESS).unwrap();
        assert_eq!(pace.wait(), Duration::ZERO);
        assert!(!pace.wait().is_zero());
    }
}
