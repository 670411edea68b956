//! Readers against files that other programs write.

use std::io::Cursor;

use exif::{Field, In, Tag, Value};
use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageEncoder, ImageFormat};
use nalgebra::Point3;
use npyz::WriterBuilder;
use where2act_infer::read::{DepthMap, parse_depth_png, parse_mask, parse_npy, parse_picture, parse_scan};

fn points(n: usize) -> Vec<Point3<f32>> {
    (0..n).map(|i| Point3::new(i as f32 * 0.01, (i % 7) as f32 - 3.0, 1.0 + i as f32 * 1e-3)).collect()
}

#[test]
fn ply_files_of_ply_rs() {
    use ply_rs_bw::ply::{
        Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType, ScalarType,
    };
    for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
        let mut ply = Ply::<DefaultElement>::new();
        ply.header.encoding = encoding;
        let mut vertex = ElementDef::new("vertex".to_owned());
        for name in ["nx", "x", "y", "z"] {
            let kind = if name == "nx" { ScalarType::Double } else { ScalarType::Float };
            vertex.properties.add(PropertyDef::new(name.to_owned(), PropertyType::Scalar(kind)));
        }
        ply.header.elements.add(vertex);
        let element = |p: &Point3<f32>| {
            let mut element = DefaultElement::new();
            element.insert("nx".to_owned(), Property::Double(0.25));
            for (name, value) in [("x", p.x), ("y", p.y), ("z", p.z)] {
                element.insert(name.to_owned(), Property::Float(value));
            }
            element
        };
        ply.payload.insert("vertex".to_owned(), points(100).iter().map(element).collect());
        let mut bytes = Vec::new();
        ply_rs_bw::writer::Writer::new().write_ply(&mut bytes, &mut ply).unwrap();
        assert_eq!(parse_scan(&bytes).unwrap(), points(100), "{encoding:?}");
    }
}

#[test]
fn pcd_files_of_pcd_rs() {
    use pcd_rs::{DynRecord, Field, FieldDef, Schema, ValueKind};
    let field = |name: &str, kind| FieldDef { name: name.to_owned(), kind, count: 1 };
    for kind in [pcd_rs::DataKind::Ascii, pcd_rs::DataKind::Binary] {
        let mut bytes = Cursor::new(Vec::new());
        let writer = pcd_rs::WriterInit {
            width: 100,
            height: 1,
            viewpoint: Default::default(),
            data_kind: kind,
            schema: Some(Schema {
                fields: vec![
                    field("intensity", ValueKind::U8),
                    field("x", ValueKind::F32),
                    field("y", ValueKind::F32),
                    field("z", ValueKind::F32),
                ],
            }),
            version: None,
        };
        let mut writer: pcd_rs::Writer<DynRecord, _> = writer.build_from_writer(&mut bytes).unwrap();
        for p in points(100) {
            let xyz = [p.x, p.y, p.z].map(|x| Field::F32(vec![x]));
            writer.push(&DynRecord([vec![Field::U8(vec![200])], xyz.to_vec()].concat())).unwrap();
        }
        writer.finish().unwrap();
        assert_eq!(parse_scan(bytes.get_ref()).unwrap(), points(100), "{kind:?}");
    }
}

#[test]
fn npy_files_of_npyz_in_both_orders() {
    for order in [npyz::Order::C, npyz::Order::Fortran] {
        let mut bytes = Vec::new();
        let options = npyz::WriteOptions::new().default_dtype().shape(&[100, 3]).order(order);
        let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
        let rows = points(100);
        let values: Vec<f64> = match order {
            npyz::Order::C => rows.iter().flat_map(|p| [p.x, p.y, p.z].map(f64::from)).collect(),
            npyz::Order::Fortran => (0..3).flat_map(|a| rows.iter().map(move |p| f64::from(p[a]))).collect(),
        };
        writer.extend(values).unwrap();
        writer.finish().unwrap();
        assert_eq!(parse_scan(&bytes).unwrap(), rows, "{order:?}");
        assert_eq!(parse_npy(&bytes).unwrap().shape, [100, 3]);
    }
}

#[test]
fn depth_maps_and_points_of_sixteen_bits() {
    let halves = |shape: &str, values: &[f32]| {
        let header = format!("{{'descr': '<f2', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values.iter().flat_map(|&v| half::f16::from_f32(v).to_le_bytes()));
        bytes
    };
    let bytes = halves("(2, 3)", &[0.5, -0.25, 1.0, 2.0, 0.125, 1.5]);
    assert_eq!(parse_scan(&bytes).unwrap(), [Point3::new(0.5, -0.25, 1.0), Point3::new(2.0, 0.125, 1.5)]);
    let depth = DepthMap::from_npy(&halves("(2, 3, 1)", &[0.5, 0.0, 1.0, 2.0, 0.125, 1.5]), 0.001).unwrap();
    assert_eq!((depth.size.width, depth.size.height, depth.metres[3]), (3, 2, 2.0));
    let mut saturated = Cursor::new(Vec::new());
    let depth = image::ImageBuffer::from_fn(3, 1, |x, _| image::Luma([[0u16, 1500, u16::MAX][x as usize]]));
    DynamicImage::ImageLuma16(depth).write_to(&mut saturated, ImageFormat::Png).unwrap();
    assert_eq!(parse_depth_png(saturated.get_ref(), 0.5).unwrap().metres, [0.0, 750.0, 0.0]);
    // A depth map without a camera is no scan.
    let square = parse_scan(&halves("(12, 12)", &[1.0; 144])).unwrap_err().to_string();
    assert!(square.contains("[points, 3]") && square.contains("[12, 12]"), "{square}");
}

/// A picture whose left half is red and whose right half is blue, as every pixel format of png and jpeg there is.
#[test]
fn every_kind_of_pixel_becomes_rgb() {
    let rgba = image::RgbaImage::from_fn(16, 16, |x, _| {
        image::Rgba(if x < 8 { [230, 40, 30, 255] } else { [20, 60, 220, 255] })
    });
    let picture = DynamicImage::ImageRgba8(rgba);
    let png = |picture: DynamicImage| {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
        parse_picture(bytes.get_ref()).unwrap()
    };
    let near = |a: [u8; 3], b: [u8; 3], by: i32| {
        a.iter().zip(b).all(|(a, b)| (i32::from(*a) - i32::from(b)).abs() <= by)
    };
    for sixteen in
        [DynamicImage::ImageRgb16(picture.to_rgb16()), DynamicImage::ImageRgba16(picture.to_rgba16())]
    {
        let read = png(sixteen);
        assert_eq!(read.opaque, None);
        assert!(near(read.rgb[0], [230, 40, 30], 1) && near(read.rgb[15], [20, 60, 220], 1));
    }
    for grey in
        [DynamicImage::ImageLuma8(picture.to_luma8()), DynamicImage::ImageLumaA16(picture.to_luma_alpha16())]
    {
        let read = png(grey);
        assert!(read.rgb.iter().all(|[r, g, b]| r == g && g == b) && read.rgb[0] != read.rgb[15]);
    }
    // What is transparent is white; half transparent is half way.
    let glass =
        image::RgbaImage::from_fn(4, 1, |x, _| image::Rgba([200, 0, 100, [0, 128, 255, 255][x as usize]]));
    let read = png(DynamicImage::ImageRgba8(glass));
    assert_eq!((read.rgb[0], read.rgb[2]), ([255; 3], [200, 0, 100]));
    assert_eq!(read.opaque, Some(vec![false, true, true, true]));
    assert!(near(read.rgb[1], [227, 127, 177], 1));
    // Written with Pillow 12: `Image.convert("CMYK").save(quality=95)` of the picture above.
    let read = parse_picture(include_bytes!("data/cmyk.jpg")).unwrap();
    assert!(near(read.rgb[8 * 16 + 3], [230, 40, 30], 12), "{:?}", read.rgb[8 * 16 + 3]);
    assert!(near(read.rgb[8 * 16 + 12], [20, 60, 220], 12), "{:?}", read.rgb[8 * 16 + 12]);
}

#[test]
fn exif_turns_pictures_upright() {
    // TIFF, little-endian, one entry: orientation (0x0112), short, 1 value, 6 = turn 90 degrees clockwise.
    let exif =
        [b"II*\0\x08\0\0\0".as_slice(), &[1, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0, 0, 0, 0, 0]].concat();
    let sideways = image::RgbImage::from_fn(32, 16, |x, _| {
        image::Rgb(if x < 16 { [250, 10, 10] } else { [10, 10, 250] })
    });
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
    encoder.set_exif_metadata(exif).unwrap();
    encoder.encode_image(&sideways).unwrap();
    let read = parse_picture(&bytes).unwrap();
    assert!(read.turned);
    assert_eq!((read.size.width, read.size.height), (16, 32));
    let [upper, lower] = [read.rgb[8 * 16 + 8], read.rgb[24 * 16 + 8]];
    assert!(upper[0] > 200 && lower[2] > 200, "left becomes up: {upper:?} {lower:?}");
}

/// A jpeg of `size` with an EXIF block of such numbers.
fn photo(size: [u32; 2], fields: &[(Tag, u16)]) -> Vec<u8> {
    let short = |&(tag, value)| Field { tag, ifd_num: In::PRIMARY, value: Value::Short(vec![value]) };
    let fields: Vec<Field> = fields.iter().map(short).collect();
    let mut writer = exif::experimental::Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, true).unwrap();
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new(&mut bytes);
    encoder.set_exif_metadata(block.into_inner()).unwrap();
    encoder.encode_image(&image::RgbImage::new(size[0], size[1])).unwrap();
    bytes
}

#[test]
fn a_photo_tells_its_camera() {
    // 26 mm on film is an angle of 79.5 degrees from corner to corner, whichever way the picture is turned and scaled.
    let sides = [(Tag::PixelXDimension, 4000), (Tag::PixelYDimension, 3000)];
    let of_phone = [(Tag::FocalLengthIn35mmFilm, 26)];
    let turned = [(Tag::Orientation, 6)];
    for fields in
        [of_phone.to_vec(), [&sides[..], &of_phone].concat(), [&turned[..], &sides, &of_phone].concat()]
    {
        let read = parse_picture(&photo([400, 300], &fields)).unwrap();
        let camera = read.camera.unwrap();
        let angle = 2.0 * (250.0 / camera.fx).atan().to_degrees();
        assert!((angle - 79.5).abs() < 0.1 && camera.fx == camera.fy, "{angle}");
        let middle = (read.size.width as f32 / 2.0, read.size.height as f32 / 2.0);
        assert_eq!((camera.cx, camera.cy), middle);
        assert_eq!(read.size.width == 300, fields.contains(&turned[0]));
    }
    let cut_out = parse_picture(&photo([300, 300], &[&sides[..], &of_phone].concat()));
    let turned_back = parse_picture(&photo([300, 400], &[&sides[..], &of_phone].concat()));
    let unknown = parse_picture(&photo([400, 300], &[(Tag::FocalLengthIn35mmFilm, 0)]));
    let fish = parse_picture(&photo([400, 300], &[(Tag::FocalLengthIn35mmFilm, 5)]));
    let without = parse_picture(&photo([400, 300], &sides));
    let no_sides = [(Tag::PixelXDimension, 0), (Tag::PixelYDimension, 0), of_phone[0]];
    for read in [cut_out, turned_back, unknown, fish, without, parse_picture(&photo([400, 300], &no_sides))] {
        assert_eq!(read.unwrap().camera, None);
    }
}

#[test]
fn one_pixel_is_a_picture_and_colour_is_no_depth() {
    let mut bytes = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(1, 1, image::Rgb([1, 2, 3])).write_to(&mut bytes, ImageFormat::Png).unwrap();
    assert_eq!(parse_picture(bytes.get_ref()).unwrap().rgb, [[1, 2, 3]]);
    assert!(parse_depth_png(bytes.get_ref(), 0.001).unwrap_err().to_string().contains("16-bit"));
    let mut bytes = Cursor::new(Vec::new());
    let mask = image::GrayImage::from_fn(3, 1, |x, _| image::Luma([[0, 127, 255][x as usize]]));
    mask.write_to(&mut bytes, ImageFormat::Png).unwrap();
    assert_eq!(parse_mask(bytes.get_ref()).unwrap().1, [false, false, true]);
}

#[test]
fn a_scan_that_saw_nothing_is_none() {
    let ply = |points: &str| {
        let header = "element vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header";
        parse_scan(format!("ply\nformat ascii 1.0\n{header}\n{points}\n").as_bytes())
    };
    // What organised clouds have where nothing was seen keeps its place.
    assert_eq!(ply("0 0 0\n0 0 1.5").unwrap(), [Point3::origin(), Point3::new(0.0, 0.0, 1.5)]);
    let refused = ply("0 0 0\n-0 0 0").unwrap_err().to_string();
    assert!(refused.contains("(0, 0, 0), found 2 points"), "{refused}");
}
