//! Where a training computes: on the CPU, or on a graphics processor in a build that knows CUDA.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
#[cfg(feature = "train-cuda")]
use burn::tensor::DeviceType;

use super::error::TrainingError;

/// What a training is to compute on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first graphics processor that CUDA finds, if there is one; else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// The graphics processor that CUDA has under that number.
    Cuda(usize),
}

impl DeviceChoice {
    /// What this comes to on this computer: never [`Auto`](Self::Auto).
    ///
    /// # Errors
    /// [`TrainingError::NoSuchDevice`].
    pub fn settled(self) -> Result<Self, TrainingError> {
        let found = cuda_devices().len();
        match self {
            Self::Auto => Ok(if found > 0 { Self::Cuda(0) } else { Self::Cpu }),
            Self::Cuda(number) if number >= found => {
                let reason = match (cfg!(feature = "train-cuda"), found) {
                    (false, _) => "this build knows the CPU alone; build it with `--features train-cuda`",
                    (true, 0) => "CUDA finds no graphics processor here; train on the CPU",
                    (true, _) => "CUDA has no graphics processor of that number; they count from 0",
                };
                Err(TrainingError::NoSuchDevice { wanted: self, reason })
            }
            Self::Cpu | Self::Cuda(_) => Ok(self),
        }
    }

    /// The device itself.
    ///
    /// # Errors
    /// [`TrainingError::NoSuchDevice`].
    pub fn open(self) -> Result<Device, TrainingError> {
        match self.settled()? {
            Self::Cuda(number) => Ok(cuda_devices().swap_remove(number)),
            Self::Auto | Self::Cpu => Ok(Device::flex()),
        }
    }
}

/// All graphics processors that CUDA finds.
#[cfg(feature = "train-cuda")]
fn cuda_devices() -> Vec<Device> {
    Device::enumerate(DeviceType::Cuda).into_iter().collect()
}

/// A build without CUDA finds none.
#[cfg(not(feature = "train-cuda"))]
fn cuda_devices() -> Vec<Device> {
    Vec::new()
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let unknown = || format!("{text} is no device; there are auto, cpu, cuda and cuda:NUMBER");
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "cuda" => Ok(Self::Cuda(0)),
            _ => {
                let number = text.strip_prefix("cuda:").ok_or_else(unknown)?;
                Ok(Self::Cuda(number.parse().map_err(|_| unknown())?))
            }
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(formatter, "auto"),
            Self::Cpu => write!(formatter, "cpu"),
            Self::Cuda(number) => write!(formatter, "cuda:{number}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_read_as_it_is_written() {
        for device in [DeviceChoice::Auto, DeviceChoice::Cpu, DeviceChoice::Cuda(0), DeviceChoice::Cuda(3)] {
            assert_eq!(device.to_string().parse(), Ok(device));
        }
        assert_eq!("cuda".parse(), Ok(DeviceChoice::Cuda(0)));
        for unknown in ["", "gpu", "cuda:", "cuda:-1", "cuda:x", "CPU"] {
            assert!(unknown.parse::<DeviceChoice>().unwrap_err().contains("no device"), "{unknown}");
        }
    }

    #[test]
    fn what_is_not_there_is_refused_and_auto_comes_to_what_is() {
        let refused = DeviceChoice::Cuda(1_000_000).settled().unwrap_err().to_string();
        assert!(refused.starts_with("no device cuda:1000000: "), "{refused}");
        assert_ne!(DeviceChoice::Auto.settled().unwrap(), DeviceChoice::Auto);
        assert_eq!(DeviceChoice::Cpu.settled().unwrap(), DeviceChoice::Cpu);
        assert!(DeviceChoice::Auto.open().is_ok());
    }
}
