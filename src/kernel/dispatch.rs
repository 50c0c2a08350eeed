//! One loop, several processors: a body that is inlined is compiled for plain instructions and for newer ones, and the
//! running processor chooses. Loops over short arrays become vector instructions that way (on ARM its plain ones are
//! such already), and every processor answers the same. Closures that such a body hands to iterators or arrays may be
//! compiled apart, as plain instructions: in inner loops it has none.

/// Defines a function that runs `$body`, which must be `#[inline(always)]`, compiled for what the processor offers.
macro_rules! for_every_processor {
    ($(#[$attribute:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $body:ident) => {
        $(#[$attribute])*
        $visibility fn $name($($argument: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,bmi1,bmi2")]
                fn avx2($($argument: $type),*) {
                    $body($($argument),*);
                }
                if crate::kernel::has_avx2() {
                    #[expect(unsafe_code, reason = "code for newer processors runs behind a check that this is one")]
                    // SAFETY: the processor has what the function was compiled for.
                    return unsafe { avx2($($argument),*) };
                }
            }
            $body($($argument),*);
        }
    };
}

pub(crate) use for_every_processor;

/// Whether this processor has AVX2, BMI1 and BMI2.
#[cfg(target_arch = "x86_64")]
pub(crate) fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2")
}

/// The instructions that inner loops use on this processor, such as "AVX2".
#[must_use]
pub fn instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        return "AVX2";
    }
    if cfg!(target_arch = "x86_64") {
        "SSE2"
    } else if cfg!(target_arch = "aarch64") {
        "NEON"
    } else {
        "plain ones"
    }
}
