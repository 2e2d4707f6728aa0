//! PLY files.

use trocar_scene::mesh::SurfaceData;

use super::Order;

/// With properties and elements that a reader has to skip; ASCII without an order.
pub fn write_ply(surface: &SurfaceData, binary: Option<Order>) -> Vec<u8> {
    let format = match binary {
        None => "ascii",
        Some(Order::Little) => "binary_little_endian",
        Some(Order::Big) => "binary_big_endian",
    };
    let mut out = format!(
        "ply\nformat {format} 1.0\ncomment made by a test\nobj_info x\nelement vertex {}\nproperty uchar red\n\
         property double z\nproperty double y\nproperty double x\nelement other 2\nproperty list uchar short data\n\
         element face {}\nproperty float quality\nproperty list uchar int vertex_indices\nend_header\n",
        surface.positions.len(),
        surface.triangles.len()
    )
    .into_bytes();
    let mut put = |bytes: &[u8], text: String| match binary {
        None => out.extend_from_slice(format!("{text} ").as_bytes()),
        Some(Order::Little) => out.extend_from_slice(bytes),
        Some(Order::Big) => out.extend(bytes.iter().rev()),
    };
    for p in &surface.positions {
        put(&[200], "200".into());
        [p.z, p.y, p.x].iter().for_each(|x| put(&x.to_le_bytes(), x.to_string()));
    }
    for length in [0u8, 2] {
        put(&[length], length.to_string());
        (0..length).for_each(|x| put(&i16::from(x).to_le_bytes(), x.to_string()));
    }
    for triangle in &surface.triangles {
        put(&0.5f32.to_le_bytes(), "0.5".into());
        put(&[3], "3".into());
        triangle.iter().for_each(|v| put(&v.to_le_bytes(), v.to_string()));
    }
    out
}
