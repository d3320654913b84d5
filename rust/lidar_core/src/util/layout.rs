//! The layout that serde reads for a type: fields in their order, with names and types. Only for
//! tests.
//!
//! A type is read from made-up values. In each run, an enumeration takes a variant that was not
//! seen yet, and an option takes a value until everything inside is known. A type may refuse a run,
//! because the values do not fit together; such a run still shows what was read before.

use serde::de::value::{Error as Refused, SeqDeserializer};
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, Error, IntoDeserializer,
    MapAccess, SeqAccess, VariantAccess, Visitor,
};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of runs. No type of this crate needs as many.
const MOST_RUNS: usize = 500;
/// Number of elements of a list or map. Measurements have at least two values.
const ELEMENTS: usize = 2;

/// The layout of a type, as far as it is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Layout {
    Unknown,
    Plain(&'static str),
    Optional(Box<Layout>),
    List(Box<Layout>),
    Map(Box<[Layout; 2]>),
    /// A tuple or tuple struct, whose fields have no names.
    Tuple(Vec<(&'static str, Layout)>),
    Fields(&'static str, Vec<(&'static str, Layout)>),
    Choice(&'static str, Vec<(&'static str, Layout)>),
}

impl Layout {
    /// Layout of `T`.
    ///
    /// # Errors
    /// The reason why the last run was refused, if no run succeeds.
    pub(crate) fn of<T: DeserializeOwned>() -> Result<Self, Refused> {
        let mut found = Self::Unknown;
        for _ in 0..MOST_RUNS {
            let before = found.clone();
            let read = T::deserialize(Tracer(&mut found));
            if found == before {
                return read.map(|_| found);
            }
        }
        Err(Refused::custom("more runs than expected"))
    }

    /// Description in one line, without the names of types, which do not appear in the bytes.
    pub(crate) fn bare(&self) -> String {
        self.told(&mut |_, parts| format!("{{{parts}}}"))
    }

    /// Like [`Self::bare`], but with the names of types. The types are described in `types`, one
    /// per line.
    pub(crate) fn named(&self, types: &mut BTreeSet<String>) -> String {
        self.told(&mut |name, parts| {
            types.insert(format!("{name}: {parts}"));
            name.to_owned()
        })
    }

    fn told(&self, of_type: &mut impl FnMut(&str, &str) -> String) -> String {
        match self {
            Self::Unknown => "?".into(),
            Self::Plain(name) => (*name).into(),
            Self::Optional(inner) => format!("option<{}>", inner.told(of_type)),
            Self::List(inner) => format!("list<{}>", inner.told(of_type)),
            Self::Map(inner) => {
                format!("map<{}, {}>", inner[0].told(of_type), inner[1].told(of_type))
            }
            Self::Tuple(parts) => {
                let parts: Vec<_> = parts.iter().map(|(_, part)| part.told(of_type)).collect();
                match parts.first() {
                    Some(first) if parts.len() > 1 && parts.iter().all(|part| part == first) => {
                        format!("[{first}; {}]", parts.len())
                    }
                    _ => format!("({})", parts.join(", ")),
                }
            }
            Self::Fields(name, parts) | Self::Choice(name, parts) => {
                let between = if matches!(self, Self::Fields(..)) { ", " } else { " | " };
                let parts: Vec<_> = parts
                    .iter()
                    .map(|(name, part)| match part {
                        Self::Plain("nothing") => (*name).to_owned(),
                        part => format!("{name} {}", part.told(of_type)),
                    })
                    .collect();
                of_type(name, &parts.join(between))
            }
        }
    }

    fn is_known(&self) -> bool {
        match self {
            Self::Unknown => false,
            Self::Plain(_) => true,
            Self::Optional(inner) | Self::List(inner) => inner.is_known(),
            Self::Map(inner) => inner.iter().all(Self::is_known),
            Self::Tuple(parts) | Self::Fields(_, parts) | Self::Choice(_, parts) => {
                parts.iter().all(|(_, part)| part.is_known())
            }
        }
    }

    /// Set the layout to `made` if nothing is known yet.
    fn or(&mut self, made: impl FnOnce() -> Self) -> &mut Self {
        if *self == Self::Unknown {
            *self = made();
        }
        self
    }

    fn parts(&mut self) -> &mut [(&'static str, Layout)] {
        match self {
            Self::Tuple(parts) | Self::Fields(_, parts) | Self::Choice(_, parts) => parts,
            _ => &mut [],
        }
    }
}

fn unknown(names: &[&'static str]) -> Vec<(&'static str, Layout)> {
    names.iter().map(|name| (*name, Layout::Unknown)).collect()
}

thread_local! {
    static HEARD: RefCell<Option<BTreeMap<&'static str, Layout>>> = const { RefCell::new(None) };
}

/// For each kind of state that is opened in `during`, the layout of its type.
pub(crate) fn heard<E>(
    during: impl FnOnce() -> Result<(), E>,
) -> Result<BTreeMap<&'static str, Layout>, E> {
    HEARD.set(Some(BTreeMap::new()));
    let ended = during();
    let found = HEARD.take().unwrap_or_default();
    ended.map(|()| found)
}

/// Report that a state of a `kind` is opened as a `T`.
pub(crate) fn tell<T: DeserializeOwned>(kind: &'static str) {
    HEARD.with_borrow_mut(|heard| {
        if let Some(heard) = heard {
            heard.insert(kind, Layout::of::<T>().unwrap_or(Layout::Unknown));
        }
    });
}

/// Deserialiser that provides a value for one place of a layout, and records its type there.
struct Tracer<'a>(&'a mut Layout);

macro_rules! plain {
    ($($method:ident, $visit:ident($($value:expr)?), $name:literal;)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
            self.0.or(|| Layout::Plain($name));
            visitor.$visit($($value)?)
        })*
    };
}

impl<'de> Deserializer<'de> for Tracer<'_> {
    type Error = Refused;

    plain! {
        deserialize_bool, visit_bool(true), "bool";
        deserialize_i8, visit_i8(1), "i8";
        deserialize_i16, visit_i16(1), "i16";
        deserialize_i32, visit_i32(1), "i32";
        deserialize_i64, visit_i64(1), "i64";
        deserialize_i128, visit_i128(1), "i128";
        deserialize_u8, visit_u8(1), "u8";
        deserialize_u16, visit_u16(1), "u16";
        deserialize_u32, visit_u32(1), "u32";
        deserialize_u64, visit_u64(1), "u64";
        deserialize_u128, visit_u128(1), "u128";
        deserialize_f32, visit_f32(1.0), "f32";
        deserialize_f64, visit_f64(1.0), "f64";
        deserialize_char, visit_char('a'), "char";
        deserialize_str, visit_str("a"), "text";
        deserialize_string, visit_str("a"), "text";
        deserialize_bytes, visit_bytes(&[1]), "bytes";
        deserialize_byte_buf, visit_bytes(&[1]), "bytes";
        deserialize_unit, visit_unit(), "nothing";
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Refused> {
        Err(Refused::custom("a saved state says nowhere what comes next"))
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
        self.deserialize_any(visitor)
    }

    fn deserialize_identifier<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
        self.deserialize_any(visitor)
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Refused> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Refused> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
        match self.0.or(|| Layout::Optional(Box::new(Layout::Unknown))) {
            Layout::Optional(inner) if !inner.is_known() => visitor.visit_some(Tracer(inner)),
            _ => visitor.visit_none(),
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
        match self.0.or(|| Layout::List(Box::new(Layout::Unknown))) {
            Layout::List(inner) => visitor.visit_seq(ElementsAccess(inner, ELEMENTS)),
            _ => Err(Refused::custom("no list before")),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refused> {
        match self.0.or(|| Layout::Map(Box::new([Layout::Unknown, Layout::Unknown]))) {
            Layout::Map(inner) => visitor.visit_map(Pairs(inner, ELEMENTS)),
            _ => Err(Refused::custom("no map before")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refused> {
        let parts = self.0.or(|| Layout::Tuple(unknown(&vec![""; length]))).parts();
        visitor.visit_seq(each(parts))
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refused> {
        self.deserialize_tuple(length, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refused> {
        visitor.visit_seq(each(self.0.or(|| Layout::Fields(name, unknown(fields))).parts()))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refused> {
        visitor.visit_enum(VariantsAccess(
            self.0.or(|| Layout::Choice(name, unknown(variants))).parts(),
        ))
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

impl<'de> IntoDeserializer<'de, Refused> for Tracer<'_> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// Deserialiser of these parts, one after the other.
fn each<'de>(parts: &mut [(&'static str, Layout)]) -> impl SeqAccess<'de, Error = Refused> {
    SeqDeserializer::new(parts.iter_mut().map(|(_, place)| Tracer(place)))
}

/// Deserialiser of an element that is repeated this number of times.
struct ElementsAccess<'a>(&'a mut Layout, usize);

impl<'de> SeqAccess<'de> for ElementsAccess<'_> {
    type Error = Refused;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, Refused> {
        if self.1 == 0 {
            return Ok(None);
        }
        self.1 -= 1;
        seed.deserialize(Tracer(self.0)).map(Some)
    }
}

struct Pairs<'a>(&'a mut [Layout; 2], usize);

impl<'de> MapAccess<'de> for Pairs<'_> {
    type Error = Refused;

    fn next_key_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, Refused> {
        if self.1 == 0 {
            return Ok(None);
        }
        self.1 -= 1;
        seed.deserialize(Tracer(&mut self.0[0])).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Refused> {
        seed.deserialize(Tracer(&mut self.0[1]))
    }
}

struct VariantsAccess<'a>(&'a mut [(&'static str, Layout)]);

impl<'a, 'de> EnumAccess<'de> for VariantsAccess<'a> {
    type Error = Refused;
    type Variant = OneVariant<'a>;

    fn variant_seed<S: DeserializeSeed<'de>>(
        self,
        seed: S,
    ) -> Result<(S::Value, OneVariant<'a>), Refused> {
        let number = self.0.iter().position(|(_, one)| !one.is_known()).unwrap_or_default();
        let Some((_, place)) = self.0.get_mut(number) else {
            return Err(Refused::custom("an enumeration without variants"));
        };
        let index = serde::de::value::U32Deserializer::<Refused>::new(number as u32);
        Ok((seed.deserialize(index)?, OneVariant(place)))
    }
}

struct OneVariant<'a>(&'a mut Layout);

impl<'de> VariantAccess<'de> for OneVariant<'_> {
    type Error = Refused;

    fn unit_variant(self) -> Result<(), Refused> {
        self.0.or(|| Layout::Plain("nothing"));
        Ok(())
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, Refused> {
        seed.deserialize(Tracer(self.0))
    }

    fn tuple_variant<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refused> {
        Tracer(self.0).deserialize_tuple(length, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refused> {
        let parts = self.0.or(|| Layout::Fields("", unknown(fields))).parts();
        visitor.visit_seq(each(parts))
    }
}
