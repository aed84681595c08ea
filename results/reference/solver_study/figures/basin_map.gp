set terminal svg standalone size 1100,900 dynamic noenhanced background rgb 'white' font 'sans,13'
set output 'basin_map.svg'
set datafile separator ','
set key outside right top
set grid lc rgb '#dddddd'
set palette maxcolors 10 defined (0 '#8c2d04', 0.5 '#E69F00', 1 '#fff5e1')
set cbrange [0:100]
set cblabel 'success / %'
set colorbox user origin 0.909,0.2 size 0.015,0.6
set key off
unset grid
set xrange [-5:85]
set yrange [-0.5:8.5]
set ytics ('0.05' 0, '0.06' 1, '0.07' 2, '0.1' 3, '0.15' 4, '0.3' 5, '0.6' 6, '1' 7, '2' 8)
set xtics 0,20
set xlabel 'view angle / deg'
set style fill solid noborder
set multiplot layout 3,3 margins screen 0.073, 0.891, 0.083, 0.950 spacing screen 0.055, 0.133
set title 'posit_undistorted'
set ylabel 'depth over size'
plot 'basin_map.csv' every ::1 using ($1 == 0 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'aopit'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 1 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'aopit_ray'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 2 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'ml_ray'
set ylabel 'depth over size'
plot 'basin_map.csv' every ::1 using ($1 == 3 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'oi_ray'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 4 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'prsoi'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 5 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'opencv_sqpnp'
set ylabel 'depth over size'
plot 'basin_map.csv' every ::1 using ($1 == 6 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'opencv_epnp'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 7 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
set title 'opencv_iterative'
set ylabel ''
plot 'basin_map.csv' every ::1 using ($1 == 8 ? $3 : 1/0):5:(5):(0.5):6 with boxxyerror lc palette
unset colorbox
unset multiplot
